//! Identities of the things in a map. They are never reused within a session.

use std::fmt;
use std::num::NonZeroU64;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $prefix:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(NonZeroU64);

        impl $name {
            /// The id with this number, counted from 1; `None` for 0.
            pub fn new(number: u64) -> Option<Self> {
                NonZeroU64::new(number).map(Self)
            }

            /// The number behind the id, at least 1.
            pub fn get(self) -> u64 {
                self.0.get()
            }

            pub(crate) fn from_index(index: usize) -> Self {
                Self(NonZeroU64::MIN.saturating_add(index as u64))
            }

            pub(crate) fn index(self) -> usize {
                (self.0.get() - 1) as usize
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!($prefix, "{}"), self.0)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}", self.0)
            }
        }
    };
}

id!(
    /// Identity of a keyframe.
    KeyframeId, "kf"
);
id!(
    /// Identity of a point landmark.
    PointId, "p"
);
id!(
    /// Identity of a line landmark.
    LineId, "l"
);
id!(
    /// Identity of a global primitive.
    PrimitiveId, "g"
);

/// One of the cameras that a map is made with: 0 is the map's own, others were added. A number is not given
/// twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CameraId(pub u32);

impl fmt::Display for CameraId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// A connected piece of map with one frame of reference. A session starts with submap 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SubmapId(pub u32);

impl fmt::Display for SubmapId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
