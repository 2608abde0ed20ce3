//! The one iceoryx2 segment that has a fixed name after the prefix.
//!
//! Every process that joins a group draws its number from it. iceoryx2 creates it when the first
//! process joins, readable and writable for all users. Another user that opens it then could truncate
//! it later, and every process that joins afterwards would wait for ever. So it is written here first,
//! for this user alone, with the bytes that iceoryx2 would write. Name and bytes belong to one version
//! of iceoryx2; a test compares them with a segment made by iceoryx2.

use crate::memory::SHARED_MEMORY;
use crate::private;
use std::io::{self, Write};
use std::path::Path;

/// Name after the prefix.
const NAME: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";
/// End of the segment's name.
const SUFFIX: &str = ".global_mgmt";
/// The version of iceoryx2 (0.10.0), and how many numbers have been drawn.
const WORDS: [u64; 2] = [0x000a_0000, 1];

/// Whether a file is such a segment.
pub fn is_seed(path: &Path) -> bool {
    path.to_string_lossy().ends_with(SUFFIX)
}

/// The iceoryx2 version that created it, which is part of its name: `…node.0_10_0.global_mgmt`.
pub fn version(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_str()?.strip_suffix(SUFFIX)?;
    let (_, version) = name.rsplit_once('.')?;
    Some(version.replace('_', "."))
}

/// Creates the segment for a prefix.
pub fn make(prefix: &str) -> io::Result<()> {
    let target = Path::new(SHARED_MEMORY).join(format!("{prefix}{NAME}"));
    private::create_new_file(&target)?.write_all(&WORDS.map(u64::to_ne_bytes).concat())
}

#[cfg(test)]
mod tests {
    use super::super::{config_for, free_prefix};
    use super::{NAME, SHARED_MEMORY, SUFFIX, WORDS};
    use iceoryx2::prelude::{NodeBuilder, SignalHandlingMode, ipc};
    use std::fs;
    use std::path::Path;

    #[test]
    fn it_is_as_iceoryx2_makes_it() {
        let place = std::env::temp_dir().join(format!("tl-seed-{}", std::process::id()));
        let prefix = free_prefix().unwrap();
        let node = NodeBuilder::new()
            .config(&config_for(&place, &prefix).unwrap())
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>();
        drop(node.unwrap());
        let entries = fs::read_dir(SHARED_MEMORY).unwrap().flatten();
        let is_it = |name: &String| name.starts_with(&prefix) && name.ends_with(SUFFIX);
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let made: Vec<String> = names.filter(is_it).collect();
        let bytes = |name: &String| fs::read(Path::new(SHARED_MEMORY).join(name)).unwrap();
        let found: Vec<(String, Vec<u8>)> =
            made.iter().map(|name| (name.replacen(&prefix, "", 1), bytes(name))).collect();
        for name in &made {
            fs::remove_file(Path::new(SHARED_MEMORY).join(name)).unwrap();
        }
        fs::remove_dir_all(&place).unwrap();
        assert_eq!(found, [(NAME.into(), WORDS.map(u64::to_ne_bytes).concat())]);
    }
}
