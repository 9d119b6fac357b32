//! Every built-in stage of magline, one file each, and the numerics below them.

pub mod numerics;
