//! Shared memory that a group needs.
//!
//! For each writer iceoryx2 reserves a slot for every message that could be in use at once: with the
//! maximum number of readers, each with a full buffer and as many borrowed messages as allowed. That is
//! address space; the system allocates memory for a slot only when it is first written, and the slot
//! returned last is written next. So an ordinary match uses few slots, the first ones of the segment.
//!
//! A process that writes to memory which the system cannot provide is killed by a SIGBUS. So a group
//! checks the free memory before it starts, every writer has the usual slots of its segment allocated
//! before its first message, and nothing new is created when hardly any memory is left. Memory beyond
//! that, which pictures full of noise need, is not protected.

use iceoryx2::service::header::publish_subscribe::Header as IpcHeader;
use messages::MAX_RUNS;
use messages::topics::{self, Topic, TopicName};
use messages::{Header, Message};
use std::io;
use std::path::Path;

/// The system's file system for shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// Shared memory for the messages of one writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TopicMemory {
    /// The topic's name.
    pub topic: TopicName,
    /// Bytes of one message with all its headers.
    pub message_bytes: u64,
    /// Slots reserved for messages.
    pub places: u64,
    /// Slots in use while readers keep up or sleep: history and full buffers hold the same newest
    /// messages.
    pub usual_slots: u64,
    /// Bytes of an ordinary message.
    pub ordinary_message_bytes: u64,
    /// Writers at the same time: the stage's process and its spare.
    pub writers: u64,
}

impl TopicMemory {
    /// The shared memory of one writer to the topic whose messages have up to `capacity` elements.
    pub fn of<E: Message, H: Header>(topic: &Topic<E, H>, capacity: usize) -> Self {
        let in_readers_hands = topic.subscribers * (topic.buffer + topic.borrowed);
        let kept = topic.buffer.max(topic.history);
        // One borrowed message per reader beyond the kept ones.
        let usual = kept + topic.loaned + topic.subscribers;
        let message_bytes = message_bytes::<E, H>(capacity);
        Self {
            topic: topic.name,
            message_bytes,
            places: (in_readers_hands + topic.history + topic.loaned) as u64,
            usual_slots: usual as u64,
            ordinary_message_bytes: message_bytes.min(topic.ordinary_bytes as u64),
            writers: 1,
        }
    }

    /// Most bytes that can be in use, with the worst readers.
    pub fn reserved_bytes(&self) -> u64 {
        self.places * self.message_bytes
    }

    /// Bytes in use while readers keep up, whatever the pictures.
    pub fn usual_bytes(&self) -> u64 {
        self.usual_slots * self.message_bytes
    }
}

/// Size of a message: iceoryx2's header, ours and the elements, each aligned.
fn message_bytes<E, H>(capacity: usize) -> u64 {
    let headers = (size_of::<IpcHeader>().next_multiple_of(align_of::<H>()) + size_of::<H>())
        .next_multiple_of(align_of::<E>());
    let alignment = align_of::<IpcHeader>().max(align_of::<H>()).max(align_of::<E>());
    (headers + size_of::<E>() * capacity).next_multiple_of(alignment) as u64
}

/// The shared memory of a group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GroupMemory {
    /// One entry per topic.
    pub topics: Vec<TopicMemory>,
}

/// Queues between writers and readers, iceoryx2's bookkeeping, heartbeats and status.
const BOOKKEEPING_BYTES: u64 = 4 << 20;
/// Bytes that all other processes together need to connect to a new one.
const STARTING_BYTES: u64 = 2 << 20;
/// Below this much free memory nothing new is created. Otherwise the next process to touch new memory
/// would die of it, and that may be a healthy stage which connects to a new reader.
const MARGIN_BYTES: u64 = 512 << 10;

impl GroupMemory {
    /// Memory of a group with frames of this size.
    pub fn new(frame_bytes: usize) -> Self {
        Self::with_larger_frames(frame_bytes, frame_bytes)
    }

    /// Memory of a group with frames of this size whose source reserves room for frames of up to
    /// `most_bytes`.
    pub fn with_larger_frames(frame_bytes: usize, most_bytes: usize) -> Self {
        let with_spare = |memory: TopicMemory| TopicMemory { writers: 2, ..memory };
        Self {
            topics: vec![
                TopicMemory::of(&topics::frames(frame_bytes), most_bytes),
                with_spare(TopicMemory::of(&topics::RUNS, MAX_RUNS)),
                with_spare(TopicMemory::of(&topics::DETECTIONS, 1)),
                with_spare(TopicMemory::of(&topics::WORLD, 1)),
                TopicMemory::of(&topics::COMMANDS, 1),
                TopicMemory::of(&topics::TRUTH, 1),
            ],
        }
    }

    /// Minimum for a match: ordinary pictures, and readers that keep up.
    pub fn least_bytes(&self) -> u64 {
        let of =
            |topic: &TopicMemory| topic.usual_slots * topic.ordinary_message_bytes * topic.writers;
        self.topics.iter().map(of).sum::<u64>() + BOOKKEEPING_BYTES
    }

    /// Minimum for starting a process of a stage during a match: its own messages, and the queues that
    /// all others create for a new reader. Those others would die if memory were missing.
    pub fn start_bytes(&self, topic: TopicName) -> u64 {
        let own = self.topics.iter().filter(|memory| memory.topic == topic);
        own.map(|memory| memory.usual_slots * memory.ordinary_message_bytes).sum::<u64>()
            + STARTING_BYTES
    }

    /// Enough for every picture and every hand-over, including pictures full of noise and a new grabber
    /// while the old one is not cleaned up yet. Only readers that hold many old messages for long take
    /// more, up to [`TopicMemory::reserved_bytes`].
    pub fn ample_bytes(&self) -> u64 {
        self.topics.iter().map(|topic| topic.usual_bytes() * 2).sum::<u64>() + BOOKKEEPING_BYTES
    }
}

/// Commands that make this much room.
pub fn advice(bytes: u64) -> String {
    let megabytes = bytes.div_ceil(1 << 20).next_multiple_of(64);
    format!(
        "`mount -o remount,size={megabytes}m {SHARED_MEMORY}` as root, or start the container with \
         `--shm-size={megabytes}m`; `touchline doctor --clean` removes what dead groups have left"
    )
}

/// Reason why processes cannot share memory on this machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PlaceError {
    /// The file system is mounted read-only.
    #[error(
        "{SHARED_MEMORY} is mounted read-only, so processes cannot share memory; `mount -o remount,rw \
         {SHARED_MEMORY}` as root, or start the container with a writable one (`--tmpfs {SHARED_MEMORY}`)"
    )]
    ReadOnly,
    /// The directory does not exist.
    #[error(
        "{SHARED_MEMORY} is missing, so processes cannot share memory; `mkdir {SHARED_MEMORY} && mount -t \
         tmpfs -o mode=1777 tmpfs {SHARED_MEMORY}` as root"
    )]
    Missing,
    /// This user may not write there.
    #[error(
        "this user may not make files in {SHARED_MEMORY}, so processes cannot share memory; `chmod 1777 \
         {SHARED_MEMORY}` as root"
    )]
    Forbidden,
}

/// Whether files can be made in shared memory at all.
pub fn check_place() -> Result<(), PlaceError> {
    use rustix::fs::{Access, access};
    use rustix::io::Errno;
    match access(SHARED_MEMORY, Access::WRITE_OK | Access::EXEC_OK) {
        Err(Errno::ROFS) => Err(PlaceError::ReadOnly),
        Err(Errno::NOENT | Errno::NOTDIR) => Err(PlaceError::Missing),
        Err(Errno::ACCESS | Errno::PERM) => Err(PlaceError::Forbidden),
        // Other errors are reported better by the operation that fails.
        _ => Ok(()),
    }
}

/// Whether anything new may be created in shared memory; the error is the number of free bytes. If that
/// cannot be determined, it may.
pub fn check_margin() -> Result<(), u64> {
    match free_bytes() {
        Ok(free) if free < MARGIN_BYTES => Err(free),
        _ => Ok(()),
    }
}

/// Whether a process that reads all topics may connect to a working group; the error is the number of
/// free bytes. Every writer creates a queue for each new reader, and would die without memory for it,
/// so the reader would end the match.
pub fn check_room_for_readers() -> Result<(), u64> {
    match free_bytes() {
        Ok(free) if free < BOOKKEEPING_BYTES => Err(free),
        _ => Ok(()),
    }
}

/// Makes the system allocate memory at these addresses, as writing to them would, but without the risk
/// of a SIGBUS; `false` if there is no memory. Kernels before 5.14 cannot do that, which is not an
/// error.
#[allow(unsafe_code)]
pub fn populate(begin: *const u8, bytes: usize) -> bool {
    let page = rustix::param::page_size();
    let offset = begin.addr() % page;
    let begin = begin.wrapping_sub(offset).cast_mut().cast();
    // SAFETY: this advice changes no byte and unmaps nothing; it fails for unmapped addresses.
    let result = unsafe {
        rustix::mm::madvise(begin, offset + bytes, rustix::mm::Advice::LinuxPopulateWrite)
    };
    !matches!(result, Err(rustix::io::Errno::FAULT | rustix::io::Errno::NOMEM))
}

/// Bytes of shared memory that are still free on this machine.
pub fn free_bytes() -> io::Result<u64> {
    let data = rustix::fs::statvfs(Path::new(SHARED_MEMORY))?;
    Ok(data.f_bavail.saturating_mul(data.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Bus;
    use crate::instance::Instance;
    use std::fs;

    #[test]
    fn a_writers_segment_is_as_large_as_computed() {
        let base = std::env::temp_dir().join(format!("tl-memory-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let bus = Bus::join(&instance, "writer").unwrap();
        let _frames = bus.publisher(&topics::FRAMES, 64 * 48).unwrap();
        let _runs = bus.publisher(&topics::RUNS, MAX_RUNS).unwrap();
        let _world = bus.publisher(&topics::WORLD, 1).unwrap();
        let _status = bus.publisher(&topics::STATUS, 1000).unwrap();
        let (segments, _) = bus.namespace().segments().unwrap();
        let sizes: Vec<u64> =
            segments.iter().map(|path| fs::metadata(path).unwrap().len()).collect();
        for memory in [
            TopicMemory::of(&topics::FRAMES, 64 * 48),
            TopicMemory::of(&topics::RUNS, MAX_RUNS),
            TopicMemory::of(&topics::WORLD, 1),
            TopicMemory::of(&topics::STATUS, 1000),
        ] {
            let reserved = memory.reserved_bytes();
            // A slot costs some bytes of bookkeeping, a segment a page or two.
            let most = reserved + memory.places * 16 + (16 << 10);
            assert!(
                sizes.iter().any(|size| (reserved..most).contains(size)),
                "{memory:?} takes {reserved} bytes, but there are {sizes:?}"
            );
        }
        drop((_frames, _runs, _world, _status, bus));
        instance.wipe().unwrap();
        instance.remove_directory().unwrap();
    }

    #[test]
    fn the_usual_places_are_filled_in_before_the_first_message() {
        let base = std::env::temp_dir().join(format!("tl-filled-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let bus = Bus::join(&instance, "writer").unwrap();
        let used = || -> u64 {
            let (segments, _) = bus.namespace().segments().unwrap();
            segments
                .iter()
                .filter(|path| path.to_string_lossy().ends_with("data"))
                .map(|path| std::os::unix::fs::MetadataExt::blocks(&fs::metadata(path).unwrap()))
                .map(|blocks| blocks * 512)
                .sum()
        };
        assert_eq!(used(), 0);
        let bytes = 320 * 240;
        let mut frames = bus.publisher(&topics::FRAMES, bytes).unwrap();
        let memory = TopicMemory::of(&topics::FRAMES, bytes);
        let filled_in = used();
        assert!(filled_in >= memory.usual_bytes(), "{filled_in} of {memory:?}");
        // Readers that never read keep the same messages as the writer.
        let _sleepers = [(); 3].map(|()| bus.subscriber(&topics::FRAMES).unwrap());
        for seq in 0..300 {
            let mut loan = frames.loan(bytes).unwrap();
            loan.elements().fill(seq as u8);
            loan.parts().1.seq = seq;
            loan.send().unwrap();
        }
        assert_eq!(used(), filled_in, "messages of an ordinary match took further memory");
        drop((frames, _sleepers, bus));
        instance.wipe().unwrap();
        instance.remove_directory().unwrap();
    }

    #[test]
    fn memory_that_is_not_there_is_no_reason_to_die() {
        assert!(
            !populate(std::ptr::without_provenance(1 << 20), 1 << 20),
            "nothing is mapped there"
        );
        let bytes = vec![0_u8; 100_000];
        assert!(populate(bytes.as_ptr(), bytes.len()));
    }

    #[test]
    fn frames_dominate_and_what_is_needed_grows_with_them() {
        let memory = GroupMemory::new(640 * 480);
        let frames = memory.topics[0];
        assert_eq!(frames.topic, topics::FRAMES.name);
        assert!(frames.message_bytes > 640 * 480);
        assert!(
            memory.topics.iter().all(|topic| topic.reserved_bytes() <= frames.reserved_bytes())
        );
        assert!(memory.least_bytes() > frames.usual_bytes());
        assert!(memory.ample_bytes() > memory.least_bytes());
        let colour = GroupMemory::with_larger_frames(640 * 480, 3 * 640 * 480);
        let more = colour.least_bytes() - memory.least_bytes();
        assert!(more >= 2 * 640 * 480 * frames.usual_slots, "{more}");

        let large = GroupMemory::new(2448 * 2048);
        let kept = topics::frames(2448 * 2048).buffer as u64;
        assert!(large.least_bytes() > kept * 2448 * 2048);
        assert!(large.ample_bytes() > 2 * kept * 2448 * 2048);
    }
}
