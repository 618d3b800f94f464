-- As migrations/0012_add_readout.sql.
ALTER TABLE sessions ADD COLUMN found_readout_ns BIGINT;
ALTER TABLE sessions ADD COLUMN found_readout_sigma_ns BIGINT;
