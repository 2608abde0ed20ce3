//! The traits of messages.

use bytemuck::Pod;
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;

/// Data that can be a message: plain, of fixed layout, with a versioned type name.
pub trait Message: Pod + Debug + ZeroCopySend {}
impl<T: Pod + Debug + ZeroCopySend> Message for T {}

/// Data that can travel beside a message's elements.
pub trait Header: Message + Default {}
impl<T: Message + Default> Header for T {}

/// Data whose memory layout can be described to programs in other languages; with the feature `schema`,
/// see [`structure`](crate::structure).
#[cfg(feature = "schema")]
pub trait Described: schemars::JsonSchema {}
#[cfg(feature = "schema")]
impl<T: schemars::JsonSchema> Described for T {}

/// Data whose memory layout can be described to programs in other languages; the descriptions themselves
/// come with the feature `schema`.
#[cfg(not(feature = "schema"))]
pub trait Described {}
#[cfg(not(feature = "schema"))]
impl<T> Described for T {}
