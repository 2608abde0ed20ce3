//! Shared memory for frames.

use super::CameraError;
use client::bus::{Bus, BusError, Loan, Publisher};
use config::CameraConfig;
use messages::FrameHeader;
use messages::topics;

/// Memory for one frame, invisible to other processes until it is published. Its bytes hold an old frame.
pub type FrameLoan = Loan<u8, FrameHeader>;

/// The source of memory for frames.
pub struct FramePool {
    publisher: Publisher<u8, FrameHeader>,
}

impl FramePool {
    /// Frames a camera may hold at the same time, including those being published.
    pub const CAPACITY: usize = topics::FRAMES.loaned;

    /// Memory for frames of up to `capacity` bytes, on the topic `frames` of a lane with this camera.
    pub fn new(
        bus: &Bus,
        camera: &CameraConfig,
        lane: u8,
        capacity: usize,
    ) -> Result<Self, BusError> {
        let topic = topics::frames(camera.frame_bytes()).in_lane(lane);
        Ok(Self { publisher: bus.publisher(&topic, capacity)? })
    }

    /// Borrows memory for a frame.
    pub fn loan(&mut self, bytes: usize) -> Result<FrameLoan, CameraError> {
        self.publisher.loan(bytes).map_err(|error| CameraError::NoMemory(error.to_string()))
    }
}
