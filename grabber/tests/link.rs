//! The link to a camera that is unplugged and plugged in again.

use client::bus::Bus;
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::CameraConfig;
use messages::{BayerOrder, CameraState, PixelFormat, read_text};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use touchline_grabber::camera::{
    Arrival, Camera, Captured, Delivery, Device, Fault, FramePool, LastFrame, Link, Picture,
    Session, Stream,
};

const PICTURE: Picture = Picture {
    width: 4,
    height: 2,
    stride: 4,
    pixel_format: PixelFormat::Bayer8,
    bayer_order: BayerOrder::Rggb,
    exposure_us: 0,
};

/// Behaviour of the device the next time it is opened.
enum Turn {
    Refuses(Fault),
    /// Delivers frames with these device numbers, `None` for incomplete ones; then the fault, or silence.
    Streams(Vec<Option<u64>>, Option<Fault>),
}

struct Scripted {
    turns: Mutex<VecDeque<Turn>>,
}

impl Device for Scripted {
    fn name(&self) -> String {
        "scripted".into()
    }

    fn open(&self) -> Result<Box<dyn Session>, Fault> {
        match self.turns.lock().unwrap().pop_front() {
            None => Err(Fault::new(CameraState::Missing, "gone for good")),
            Some(Turn::Refuses(fault)) => Err(fault),
            Some(Turn::Streams(frames, end)) => Ok(Box::new(Script { frames: frames.into(), end })),
        }
    }
}

struct Script {
    frames: VecDeque<Option<u64>>,
    end: Option<Fault>,
}

impl Session for Script {
    fn promised_fps(&self) -> Option<f64> {
        Some(100.0)
    }

    fn start(self: Box<Self>, _: &mut FramePool) -> Result<(Box<dyn Stream>, String), Fault> {
        Ok((self, "a script".into()))
    }
}

impl Stream for Script {
    fn next(&mut self, pool: &mut FramePool, timeout: Duration) -> Result<Option<Arrival>, Fault> {
        match self.frames.pop_front() {
            Some(Some(device_seq)) => Ok(Some(Arrival::Frame(Delivery {
                frame: pool.loan(8).unwrap(),
                picture: PICTURE,
                device_seq,
                t_capture_ns: monotonic_ns(),
            }))),
            Some(None) => Ok(Some(Arrival::Incomplete)),
            None => match self.end.take() {
                Some(fault) => Err(fault),
                None => {
                    std::thread::sleep(timeout);
                    Ok(None)
                }
            },
        }
    }
}

struct Bench {
    link: Link,
    pool: FramePool,
    _bus: Bus,
    instance: Instance,
    base: PathBuf,
}

impl Bench {
    fn new(name: &str, last: Option<LastFrame>, turns: Vec<Turn>) -> Self {
        let base = std::env::temp_dir().join(format!("tl-link-{name}-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let bus = Bus::join(&instance, "test").unwrap();
        let pool = FramePool::new(&bus, &CameraConfig::default(), 0, 8).unwrap();
        let device = Arc::new(Scripted { turns: Mutex::new(turns.into()) });
        Self { link: Link::new(device, 100.0, last), pool, _bus: bus, instance, base }
    }

    fn state(&self) -> CameraState {
        CameraState::from_number(self.link.report().unwrap().state).unwrap()
    }

    fn problem(&self) -> String {
        read_text(&self.link.report().unwrap().problem)
    }

    /// The next frame; waits for it.
    fn frame(&mut self) -> Captured {
        let deadline = Instant::now() + Duration::from_secs(60);
        while Instant::now() < deadline {
            if let Some(captured) = self.link.capture(&mut self.pool).unwrap() {
                return captured;
            }
        }
        panic!("no frame: {:?} {}", self.state(), self.problem());
    }

    /// Polls the camera until it is in this state.
    fn until(&mut self, state: CameraState) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while self.state() != state {
            assert!(Instant::now() < deadline, "{:?} {}", self.state(), self.problem());
            assert!(self.link.capture(&mut self.pool).unwrap().is_none(), "a frame came");
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = self.instance.remove_namespace();
        let _ = std::fs::remove_dir_all(&self.base);
    }
}

fn missing() -> Fault {
    Fault::new(CameraState::Missing, "it is not there")
}

#[test]
fn a_camera_is_streamed_whenever_it_is_connected() {
    let turns = vec![
        Turn::Refuses(missing()),
        Turn::Refuses(Fault::new(CameraState::Busy, "somebody has it")),
        Turn::Streams(vec![Some(70), Some(71), Some(75)], Some(missing())),
        Turn::Streams(vec![Some(0), Some(1)], None),
    ];
    let mut bench = Bench::new("comes", None, turns);
    bench.until(CameraState::Missing);
    assert_eq!(bench.problem(), "it is not there");
    bench.until(CameraState::Busy);
    let seqs: Vec<u64> = (0..3).map(|_| bench.frame().exposure.seq).collect();
    assert_eq!(seqs, [0, 1, 5], "gaps of the device are kept");
    assert_eq!((bench.state(), bench.problem()), (CameraState::Streaming, String::new()));
    assert_eq!((bench.link.report().unwrap().lost, bench.link.report().unwrap().starts), (3, 1));
    bench.until(CameraState::Missing);
    let after = bench.frame().exposure.seq;
    assert!(after > 5, "numbers rise across the gap, which is as long as the absence: {after}");
    assert_eq!(bench.frame().exposure.seq, after + 1);
    assert_eq!(bench.link.report().unwrap().starts, 2);
    bench.until(CameraState::Hung);
    assert!(bench.problem().contains("no frame for"), "{}", bench.problem());
}

#[test]
fn incomplete_frames_are_missing_and_counted_as_such() {
    let frames = vec![Some(10), None, Some(12), None, None, Some(16)];
    let last = LastFrame { seq: 99, t_capture_ns: monotonic_ns() };
    let mut bench = Bench::new("incomplete", Some(last), vec![Turn::Streams(frames, None)]);
    let frames: Vec<Captured> = (0..3).map(|_| bench.frame()).collect();
    let first = frames[0].exposure.seq;
    assert!(first >= 100, "a predecessor's numbers are continued: {first}");
    assert_eq!([1, 2].map(|index: usize| frames[index].exposure.seq - first), [2, 6]);
    // Numbers 13 to 15 are missing, and two frames were incomplete: one of the missing ones did not arrive at
    // all.
    assert_eq!([1, 2].map(|index: usize| frames[index].exposure.skipped), [0, 1]);
    let report = bench.link.report().unwrap();
    assert_eq!((report.incomplete, report.lost), (3, 1));
}
