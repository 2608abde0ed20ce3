//! The messages of the leagues' own protocols: encoding and decoding, nothing about sockets.
//!
//! Each module holds the messages of one protocol. Names, numbers and types of the fields are those on
//! the wire, so a message made here is read by every program of the league.
//!
//! | module | protocol | lengths | angles | times |
//! |---|---|---|---|---|
//! | [`ssl_vision`], [`ssl_geometry`] | SSL-Vision | mm | rad | s since 1970 |
//! | [`ssl_tracked`] | trackers of the SSL | m | rad | s since 1970 |
//! | [`firasim`] | FIRASim, IEEE VSSS | m | rad | – |
//!
//! [`ssl_log`] is the file format in which the SSL keeps packets.
//!
//! In all of them the origin is the centre of the field, x points along it, y to the left of x, and
//! angles are counted counter-clockwise from x, as in Touchline.

pub mod firasim;
pub mod ssl_geometry;
pub mod ssl_log;
pub mod ssl_tracked;
pub mod ssl_vision;

pub use prost::{DecodeError, Message};

/// Payload of a UDP packet that fits into one Ethernet frame: 1500 bytes less the headers of IP and UDP.
/// A larger packet is divided, and is lost when one of its parts is.
pub const ONE_FRAME_BYTES: usize = 1472;
