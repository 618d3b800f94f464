//! A job that is the same everywhere: what it takes tells machines, and hours of one machine, apart. Times
//! per frame are compared between machines by their ratio to it.

use std::hint::black_box;
use std::time::Instant;

use geometry::nalgebra::{Cholesky, DMatrix};
use sha2::{Digest, Sha256};

use super::machine::process_cpu_ms;

/// Bytes hashed: whole numbers, one after the other.
const HASHED_BYTES: usize = 16 << 20;
/// Side of the matrix factorized: floating point, from memory beyond the innermost caches.
const MATRIX_SIDE: usize = 500;
/// Processor time is counted in steps of ten milliseconds: so many jobs are enough for a per cent.
const REPEATS: usize = 8;

/// Milliseconds of processor time of the job, on one thread; of the clock where the system tells no processor
/// time.
pub fn reference_ms() -> f64 {
    let began = Instant::now();
    let cpu_before = process_cpu_ms();
    for _ in 0..REPEATS {
        once();
    }
    let by_clock = began.elapsed().as_secs_f64() * 1e3;
    let used = process_cpu_ms().zip(cpu_before).map_or(by_clock, |(after, before)| after - before);
    used / REPEATS as f64
}

fn once() {
    let bytes: Vec<u8> = (0..HASHED_BYTES).map(|i| (i ^ (i >> 8)) as u8).collect();
    let matrix = DMatrix::from_fn(MATRIX_SIDE, MATRIX_SIDE, |row, column| {
        let distance = row.abs_diff(column) as f64;
        // Diagonally dominant, so that it has a factor.
        if row == column { MATRIX_SIDE as f64 } else { 1.0 / (1.0 + distance) }
    });
    black_box(Sha256::digest(black_box(&bytes)));
    black_box(Cholesky::new(black_box(matrix)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_job_takes_time() {
        let ms = reference_ms();
        assert!(ms.is_finite() && ms > 1.0, "{ms}");
    }
}
