//! What is learned from pictures, off line: nothing here runs while a match is on.
//!
//! [`labels`]: what somebody says is to be seen in a picture.

pub mod labels;
