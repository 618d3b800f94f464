//! What `/metrics` tells, in the words of Prometheus. `docs/operations.md` has this table.

/// How a number behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Only grows until the server starts again.
    Counter,
    /// Goes up and down.
    Gauge,
    /// Counts values by size.
    Histogram,
}

/// A number, or one for each of its labels' values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Measure {
    /// As Prometheus calls it.
    pub name: &'static str,
    /// How it behaves.
    pub kind: Kind,
    /// What it tells.
    pub help: &'static str,
    /// A label, with the values that are there from the start.
    pub label: Option<(&'static str, &'static [&'static str])>,
}

const fn counter(name: &'static str, help: &'static str) -> Measure {
    Measure { name, kind: Kind::Counter, help, label: None }
}

const fn gauge(name: &'static str, help: &'static str) -> Measure {
    Measure { name, kind: Kind::Gauge, help, label: None }
}

const fn histogram(name: &'static str, help: &'static str) -> Measure {
    Measure { name, kind: Kind::Histogram, help, label: None }
}

impl Measure {
    const fn by(self, label: &'static str, values: &'static [&'static str]) -> Self {
        Self { label: Some((label, values)), ..self }
    }

    /// Tells what it is. Counters and gauges are there from the start: a rate of what is not there cannot be
    /// watched.
    fn describe(&self) {
        let Self { name, kind, help, label } = *self;
        match kind {
            Kind::Counter => metrics::describe_counter!(name, help),
            Kind::Gauge => metrics::describe_gauge!(name, help),
            Kind::Histogram => metrics::describe_histogram!(name, help),
        }
        if kind == Kind::Counter {
            match label {
                None => metrics::counter!(name).increment(0),
                Some((label, values)) => {
                    values.iter().for_each(|value| metrics::counter!(name, label => *value).increment(0));
                }
            }
        }
    }
}

/// Tells what each number is.
pub fn describe() {
    MEASURES.iter().for_each(Measure::describe);
}

/// All of them.
pub const MEASURES: [Measure; 34] = [
    counter("monoslam_frames_total", "frames that were answered")
        .by("outcome", &["tracked", "weak", "lost", "initialising", "dropped", "rejected"]),
    histogram("monoslam_frame_seconds", "from the begin of a frame's tracking to its answer"),
    histogram("monoslam_frame_cpu_seconds", "processor time of that on the session's thread"),
    histogram("monoslam_frame_queued_seconds", "from a frame's arrival to the begin of its tracking"),
    histogram("monoslam_stage_seconds", "parts of a frame's tracking").by("stage", &[]),
    counter("monoslam_line_candidates_total", "candidate lines by what became of them").by("verdict", &[]),
    gauge("monoslam_sessions_loaded", "sessions in memory"),
    gauge("monoslam_streams_open", "streams of frames that are open"),
    gauge("monoslam_streams_free", "streams that are taken beyond these"),
    gauge("monoslam_fleet_servers", "servers that share the database; 0 where it is a file"),
    counter("monoslam_requests_passed_on_total", "requests that another server of the fleet had to answer")
        .by("outcome", &["answered", "failed"]),
    counter("monoslam_session_failures_total", "sessions that were closed by a fault of ours"),
    counter("monoslam_operations_total", "adjustments and mergers of maps that ended")
        .by("kind, outcome", &[]),
    counter("monoslam_commits_total", "transactions with what sessions made")
        .by("outcome", &["ok", "failed"]),
    histogram("monoslam_commit_seconds", "duration of such a transaction"),
    gauge("monoslam_storage_ready", "1 while what clients bring can be saved, else 0"),
    gauge("monoslam_database_bytes", "size of the database with its log"),
    gauge("monoslam_disk_free_bytes", "what is free where the database is, for others than root"),
    gauge("monoslam_database_check_running", "1 while damaged pages are looked for"),
    gauge("monoslam_database_check_seconds", "how long that took"),
    gauge("monoslam_database_damage", "damaged places of the database that belong to no session"),
    gauge("monoslam_sessions_damaged", "sessions that are closed because pages of theirs are damaged"),
    gauge("monoslam_connections_open", "connections of both ports"),
    counter("monoslam_connections_refused_total", "connections beyond what is allowed")
        .by("limit", &["address", "total"]),
    counter("monoslam_connections_evicted_total", "idle connections that made way for new ones"),
    counter("monoslam_requests_refused_total", "requests that were not let in, by the error's code")
        .by("code", &[]),
    counter("monoslam_messages_refused_total", "messages for which there was no room in time"),
    gauge("monoslam_bytes_in_flight", "bytes of messages that are begun or wait to be worked off"),
    gauge("monoslam_build_info", "1; the label is the program's version").by("version", &[]),
    gauge("process_resident_memory_bytes", "memory that the process takes"),
    counter("process_cpu_seconds_total", "processor time of the process, user and system"),
    gauge("process_open_fds", "open files and connections"),
    gauge("process_max_fds", "how many there may be"),
    gauge("process_start_time_seconds", "when the process began, seconds since 1970"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stands_there_once() {
        let names: std::collections::BTreeSet<_> = MEASURES.iter().map(|measure| measure.name).collect();
        assert_eq!(names.len(), MEASURES.len());
    }
}
