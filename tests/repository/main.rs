//! What must hold of the repository itself: modules import one way.

mod floors;
