//! Sessions in memory: who owns them, how frames come in and answers and map updates go out.

mod decoder;
mod events;
mod frame;
mod gallery;
mod id;
mod images;
mod journal;
mod leaps;
mod load;
mod localize;
mod queue;
mod recent;
mod registry;
mod slots;
mod sync;
mod updates;
mod view;
mod worker;
mod writer;

#[cfg(fuzzing)]
pub use decoder::decode_image;
pub use events::{MapChange, SessionEvent};
pub use frame::{Answer, Before, Encoding, FrameOutcome, Rejection, Reply, SentFrame, SentImage};
pub use gallery::ShownFrame;
pub use id::{OWNER_END, SessionId, is_name};
pub use images::as_file;
pub use journal::{Revision, SceneChanges, Since};
pub use load::LoadContext;
pub use localize::{Located, localize};
pub use queue::{Closed, Ending, FrameQueue, Policy, Queued};
pub use registry::{OpenRequest, Registry};
pub use view::{Live, LoadedView, SessionView};
pub use worker::{Mode, Replies};
