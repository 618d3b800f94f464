//! Sessions in memory: who owns them, how frames come in and answers and map updates go out.

mod decoder;
mod events;
mod frame;
mod gallery;
mod id;
mod images;
mod journal;
mod leaps;
mod leases;
mod load;
mod mask_keeper;
mod occupancy;
mod queue;
mod recent;
mod registry;
mod slots;
mod sync;
mod updates;
mod view;
mod whole;
mod worker;
mod writer;

pub use decoder::{brightest, decode_image};
pub use events::{Events, MapChange, SessionEvent};
pub use frame::{Answer, Before, Encoding, FrameOutcome, Rejection, Reply, SentFrame, SentImage};
pub use gallery::ShownFrame;
pub use id::{OWNER_END, SessionId, is_name};
pub use images::as_file;
pub use journal::{Revision, SceneChanges, Since};
pub use leases::{VERSION, keep};
pub use load::{LoadContext, read};
pub use queue::{Closed, Ending, FrameQueue, Policy, Queued};
pub use registry::{OpenRequest, Registry};
pub use view::{Live, LoadedView, SessionView};
pub use whole::{Adjusted, Joined, adjust, join};
pub use worker::{Mode, Replies};
