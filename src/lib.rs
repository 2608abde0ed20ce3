//! Parts of the program `touchline` that tests, tools and a web page use as well.
//!
//! * [`supervisor`] runs a group of processes and carries out requests; [`monitor`] counts what they do and publishes
//!   the report, which [`control::read_status`] reads.
//! * [`attendants`] lists the processes that serve people and programs: [`gateway`], [`publisher`], [`console`].
//! * [`recorder`] writes recordings, [`replay`] computes them again, [`viewing`] shows them.
//! * [`live_frames`] copies frames of a running group; [`setup_worker`] sets a pitch up from them in a process of its
//!   own.
//! * [`top_scale`] measures whether robot tops have the configured size, [`colorless`] whether pictures have colours;
//!   [`drawing`] shows results on pictures.
//!
//! The command line and the commands are the program's alone.

// A process outlives the readers of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]
// Module documentation is written for readers of the source, where links to private modules work.
#![allow(rustdoc::private_intra_doc_links)]

pub mod attendants;
pub mod colorless;
pub mod console;
pub mod drawing;
pub mod gateway;
pub mod live_frames;
pub mod monitor;
pub mod publisher;
pub mod recorder;
pub mod replay;
pub mod setup_worker;
pub mod supervisor;
pub mod top_scale;
pub mod viewing;
