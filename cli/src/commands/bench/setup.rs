//! What a run is made with: the pace of the frames and the features that are on.

use clap::ValueEnum;

/// How fast frames come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// As fast as every one is tracked.
    Fast,
    /// As recorded.
    Realtime,
}

impl Pace {
    /// The word of the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Realtime => "realtime",
        }
    }
}

/// Which features are on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Configuration {
    /// The default options of a session.
    Default,
    /// Points.
    P,
    /// Points and lines.
    Lp,
    /// Points, lines and global primitives.
    Gp,
}

impl Configuration {
    /// The configurations of an ablation, each with one kind of feature more.
    pub const ABLATION: [Self; 3] = [Self::P, Self::Lp, Self::Gp];

    /// The word of the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::P => "P",
            Self::Lp => "LP",
            Self::Gp => "GP",
        }
    }
}
