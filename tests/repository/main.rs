//! What must hold of the repository itself: links between documents resolve.

mod files;
mod links;
mod markdown;
//! What must hold of the repository itself: modules import one way.

mod floors;
