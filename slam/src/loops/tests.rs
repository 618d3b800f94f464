//! Loops on maps made by hand.
