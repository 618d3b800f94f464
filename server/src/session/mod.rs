//! Sessions in memory: who owns them, how frames come in and answers and map updates go out.

mod decoder;
mod frame;
mod id;
mod images;
mod load;
mod queue;
mod recent;
mod registry;
mod worker;
mod writer;

pub use frame::{Answer, Before, Encoding, Rejection, Reply, SentFrame, SentImage};
pub use id::SessionId;
pub use images::ImageFile;
pub use queue::{Closed, Ending, FrameQueue, Policy, Queued};
pub use registry::{LoadedView, OpenRequest, Registry};
pub use worker::{Live, Mode, Replies};
