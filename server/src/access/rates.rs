//! How often: requests of a caller, and frames of its streams.

use crate::error::{ApiError, ErrorCode};
use governor::clock::{Clock, DefaultClock};
use governor::{DefaultDirectRateLimiter, DefaultKeyedRateLimiter, Quota, RateLimiter};
use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::Duration;

/// Whose requests are counted together.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Asker {
    /// Those with a token of this name.
    Token(String),
    /// Those without, from an address.
    Address(Option<IpAddr>),
}

/// Limits the requests of each caller.
pub struct RequestRates(DefaultKeyedRateLimiter<Asker>);

impl RequestRates {
    /// So many a second, and so many at once before that counts.
    pub fn new(per_s: u32, burst: u32) -> Self {
        let at_least_one = |n: u32| NonZeroU32::new(n).unwrap_or(NonZeroU32::MIN);
        let quota = Quota::per_second(at_least_one(per_s)).allow_burst(at_least_one(burst));
        Self(RateLimiter::keyed(quota))
    }

    /// Counts a request.
    ///
    /// # Errors
    /// If there were too many, with the time after which one is taken again.
    pub fn count(&self, asker: &Asker) -> Result<(), ApiError> {
        self.0.check_key(asker).map_err(|not_until| {
            let wait = not_until.wait_time_from(DefaultClock::default().now());
            let sentence = "more requests than this server takes of one caller; slow down";
            ApiError::new(ErrorCode::RateLimited, sentence).retry_after(wait)
        })
    }

    /// Forgets callers who have not asked lately.
    pub fn forget_idle(&self) {
        self.0.retain_recent();
        self.0.shrink_to_fit();
    }
}

/// Limits the frames of a caller. Clones count together.
#[derive(Clone)]
pub struct FrameRate {
    limiter: Arc<DefaultDirectRateLimiter>,
    per_s: f64,
}

impl FrameRate {
    /// So many a second; as many as of two seconds may come at once.
    pub fn new(per_s: f64) -> Self {
        let period = Duration::from_secs_f64(1.0 / per_s.max(1e-6));
        let burst = NonZeroU32::new((2.0 * per_s).ceil() as u32).unwrap_or(NonZeroU32::MIN);
        let quota =
            Quota::with_period(period).unwrap_or(Quota::per_second(NonZeroU32::MAX)).allow_burst(burst);
        Self { limiter: Arc::new(RateLimiter::direct(quota)), per_s }
    }

    /// Counts a frame; how long to wait if it is one too many.
    pub fn count(&self) -> Result<(), Duration> {
        self.limiter.check().map_err(|not_until| not_until.wait_time_from(DefaultClock::default().now()))
    }

    /// Waits until a frame may come, and counts it.
    pub async fn turn(&self) {
        while let Err(wait) = self.count() {
            tokio::time::sleep(wait).await;
        }
    }

    /// Why a frame is one too many, in a plain sentence.
    pub fn sentence(&self) -> String {
        format!("more than {} frames a second, which is what this token may send", self.per_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn callers_are_counted_apart_and_told_when_to_come_again() {
        let rates = RequestRates::new(1, 2);
        let (a, b) = (Asker::Token("a".into()), Asker::Address(None));
        assert!(rates.count(&a).is_ok() && rates.count(&a).is_ok());
        let refused = rates.count(&a).unwrap_err();
        assert_eq!(refused.code, ErrorCode::RateLimited);
        let wait = refused.retry_after.unwrap();
        assert!(wait > Duration::ZERO && wait <= Duration::from_secs(1), "{wait:?}");
        assert!(rates.count(&b).is_ok());
    }

    #[test]
    fn frames_beyond_the_rate_wait() {
        let rate = FrameRate::new(0.5);
        assert!(rate.count().is_ok());
        assert!(rate.count().unwrap_err() > Duration::from_secs(1));
    }
}
