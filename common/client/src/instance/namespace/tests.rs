use super::*;
use crate::bus::Bus;
use bytemuck::Zeroable;
use messages::WorldFrame;
use messages::topics;
use std::os::unix::fs::PermissionsExt;

/// An instance whose directories are removed at the end of the test.
struct Scratch {
    base: PathBuf,
    instance: Instance,
}

impl Scratch {
    fn new(name: &str) -> Self {
        let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        Self { base, instance }
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = self.instance.remove_namespace();
        let _ = fs::remove_dir_all(&self.base);
    }
}

#[test]
fn names_are_unpredictable_and_every_process_of_the_group_finds_them() {
    let scratch = Scratch::new("namespace-random");
    let instance = &scratch.instance;
    assert_eq!(instance.namespace().unwrap(), None);
    let makers: Vec<_> = (0..8)
        .map(|_| {
            let instance = instance.clone();
            std::thread::spawn(move || instance.create_namespace().unwrap())
        })
        .collect();
    let first = instance.create_namespace().unwrap();
    for maker in makers {
        assert_eq!(maker.join().unwrap(), first, "two were made");
    }
    assert_eq!(instance.namespace().unwrap().as_ref(), Some(&first));
    assert_eq!(fs::metadata(first.directory()).unwrap().permissions().mode() & 0o777, 0o700);

    instance.remove_namespace().unwrap();
    assert_eq!(instance.namespace().unwrap(), None);
    assert!(!first.directory().exists());
    let second = instance.create_namespace().unwrap();
    assert_ne!((first.directory(), first.prefix()), (second.directory(), second.prefix()));
}

#[test]
fn a_group_whose_runtime_directory_is_gone_is_found_and_the_note_put_back() {
    let scratch = Scratch::new("namespace-lost");
    let instance = &scratch.instance;
    let namespace = instance.create_namespace().unwrap();
    assert!(!instance.restore_namespace(&namespace).unwrap(), "nothing is missing");
    fs::remove_dir_all(instance.directory()).unwrap();
    assert_eq!(instance.namespace().unwrap().as_ref(), Some(&namespace));
    assert_eq!(Instance::below(&scratch.base, "other").unwrap().namespace().unwrap(), None);
    instance.create_directory().unwrap();
    assert_eq!(instance.create_namespace().unwrap(), namespace, "another one was made");
    assert!(instance.restore_namespace(&namespace).unwrap());
    assert!(instance.directory().join(NOTE).exists());
    fs::remove_dir_all(namespace.directory()).unwrap();
    assert!(instance.restore_namespace(&namespace).unwrap());
    assert_eq!(instance.namespace().unwrap(), Some(namespace));
}

#[test]
fn half_a_note_and_one_of_a_place_that_is_gone_are_none() {
    let scratch = Scratch::new("namespace-note");
    let instance = &scratch.instance;
    let namespace = instance.create_namespace().unwrap();
    let text = namespace.note();
    assert_eq!(Namespace::from_note(&text), Some(namespace));
    for end in 0..text.len() {
        assert_eq!(Namespace::from_note(&text[..end]), None);
    }
    instance.remove_namespace().unwrap();
    assert!(instance.directory().join(NOTE).exists());
    assert_eq!(instance.namespace().unwrap(), None);
    instance.create_namespace().unwrap();
}

/// Includes the segment that iceoryx2 creates for all users.
#[test]
fn nothing_that_others_can_see_can_be_opened_by_them() {
    let scratch = Scratch::new("namespace-modes");
    let bus = Bus::join(&scratch.instance, "somebody").unwrap();
    let _world = bus.publisher(&topics::WORLD, 1).unwrap();
    let namespace = scratch.instance.namespace().unwrap().unwrap();
    let (segments, foreign) = namespace.segments().unwrap();
    assert!(segments.len() >= 3 && foreign.is_empty(), "{segments:?} {foreign:?}");
    let versions: Vec<_> = segments.iter().filter_map(|path| seed::version(path)).collect();
    assert_eq!(versions, [IPC_VERSION], "the constant is out of date");
    assert_eq!(namespace.strange_versions().unwrap(), Vec::<String>::new());
    for path in &segments {
        let mode = fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{}", path.display());
    }
    drop((_world, bus));
    scratch.instance.wipe().unwrap();
    let (segments, _) = namespace.segments().unwrap();
    assert_eq!(segments.len(), 1, "for the next group: {segments:?}");
    Bus::join(&scratch.instance, "next").unwrap();
}

#[test]
fn a_program_that_joins_while_leftovers_are_removed_does_no_harm_when_it_leaves() {
    let scratch = Scratch::new("namespace-joiner");
    scratch.instance.create_namespace().unwrap();
    let leftovers = scratch.instance.leftovers().unwrap();
    let early = Bus::join(&scratch.instance, "early").unwrap();
    let reader = early.subscriber(&topics::WORLD).unwrap();
    leftovers.remove().unwrap();
    let group = Bus::join(&scratch.instance, "group").unwrap();
    group.enter_roster();
    let mut writer = group.publisher(&topics::WORLD, 1).unwrap();
    drop((reader, early));
    let late = Bus::join(&scratch.instance, "late").unwrap();
    let reader = late.subscriber(&topics::WORLD).unwrap();
    writer.publish(&WorldFrame::zeroed()).unwrap();
    assert!(reader.receive().unwrap().is_some(), "the writer's topic is another one");
}

#[test]
#[ignore = "needs root, to make what belongs to another user"]
fn foreign_files_among_the_groups_stay_and_are_named() {
    const NOBODY: u32 = 65_534;
    let scratch = Scratch::new("namespace-foreign");
    let namespace = scratch.instance.create_namespace().unwrap();
    let path = Path::new(SHARED_MEMORY).join(format!("{}world.count", namespace.prefix()));
    fs::write(&path, "").unwrap();
    std::os::unix::fs::chown(&path, Some(NOBODY), Some(NOBODY)).unwrap();
    let foreign = scratch.instance.wipe().unwrap();
    assert_eq!(foreign, [ForeignFile { path: path.clone(), uid: NOBODY }]);
    assert!(foreign[0].to_string().contains("another user (uid 65534)"), "{}", foreign[0]);
    assert!(path.exists());
    // A directory of another user that claims to belong to this group.
    let theirs = make_directory().unwrap();
    fs::write(theirs.join(NOTE), namespace.note()).unwrap();
    for path in [&theirs.join(NOTE), &theirs] {
        std::os::unix::fs::chown(path, Some(NOBODY), Some(NOBODY)).unwrap();
    }
    assert_eq!(Namespace::all().unwrap().iter().filter(|all| **all == namespace).count(), 1);
    fs::remove_dir_all(&theirs).unwrap();
    fs::remove_file(&path).unwrap();
}

/// The path of a listener's socket must fit into the system's limit.
#[test]
fn programs_in_other_languages_can_sleep_on_the_event_of_a_topic() {
    use iceoryx2::prelude::*;
    let scratch = Scratch::new("namespace-event");
    let bus = Bus::join(&scratch.instance, "writer").unwrap();
    let mut world = bus.publisher(&topics::WORLD, 1).unwrap();
    let config = scratch.instance.namespace().unwrap().unwrap().ipc_config().unwrap();
    let node = NodeBuilder::new().config(&config).create::<ipc::Service>().unwrap();
    let event = node.service_builder(&"world".try_into().unwrap()).event().open().unwrap();
    let listener = event.listener_builder().create().unwrap();
    world.publish(&bytemuck::Zeroable::zeroed()).unwrap();
    let mut events = 0;
    listener.timed_wait(|_| events += 1, Duration::from_secs(5)).unwrap();
    assert!(events > 0);
}

#[test]
fn a_group_with_another_version_of_iceoryx2_is_refused_at_once_by_its_name() {
    let scratch = Scratch::new("namespace-version");
    let namespace = scratch.instance.create_namespace().unwrap();
    let other = Namespace { ipc_version: "0.9.3".into(), ..namespace.clone() };
    for place in [namespace.directory(), scratch.instance.directory()] {
        write_note(&place.join(NOTE), &other).unwrap();
    }
    let refusal = Bus::join(&scratch.instance, "somebody").err().unwrap().to_string();
    assert!(refusal.contains("\"test\" uses iceoryx2 0.9.3"), "{refusal}");
    assert!(refusal.contains(&format!("this program {IPC_VERSION}")), "{refusal}");
    // A program that ignores the note leaves its own segment.
    let theirs = format!("{}00_node.0_9_3.global_mgmt", namespace.prefix());
    fs::write(Path::new(SHARED_MEMORY).join(theirs), "").unwrap();
    let strange = namespace.strange_versions().unwrap();
    assert!(
        strange.len() == 1 && strange[0].contains("with iceoryx2 0.9.3 has tried"),
        "{strange:?}"
    );
}
