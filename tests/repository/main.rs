//! What must hold of the repository itself: citations of the method and links between documents resolve,
//! commands of documents name what exists, comments are as narrow as code, and modules import one way,
//! and operations are documented as they are.

mod citations;
mod commands;
mod comments;
mod files;
mod floors;
mod links;
mod markdown;
mod operations;
mod viewer;
