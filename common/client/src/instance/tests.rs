//! Tests: which runtime directories are accepted.

use super::*;

#[test]
fn a_place_too_deep_for_sockets_is_refused_before_it_is_used() {
    let base = PathBuf::from("/").join("x".repeat(MAX_DIRECTORY - 6));
    assert!(Instance::below(&base, "four").is_ok());
    let error = Instance::below(&base, "fiver").unwrap_err().to_string();
    assert!(error.contains(RUNTIME_DIR_VARIABLE), "{error}");
    let longest = Instance::below(Path::new("/run/user/4294967/touchline"), &"x".repeat(MAX_NAME));
    assert!(longest.is_ok(), "the longest name must fit into the usual place: {longest:?}");
}

/// A separate directory for each test, removed at the end.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn mode(path: &Path) -> u32 {
    fs::symlink_metadata(path).unwrap().mode() & 0o7777
}

fn refusal(instance: &Instance) -> String {
    instance.create_directory().unwrap_err().to_string()
}

#[test]
fn the_runtime_directory_is_for_nobody_else() {
    let scratch = Scratch::new("instance-private");
    let base = scratch.0.join("base");
    let instance = Instance::below(&base, "match").unwrap();
    instance.create_directory().unwrap();
    assert_eq!((mode(&base), mode(instance.directory())), (0o700, 0o700));
    // A service manager may create it readable by all users.
    fs::set_permissions(instance.directory(), fs::Permissions::from_mode(0o755)).unwrap();
    instance.create_directory().unwrap();
    assert_eq!(mode(instance.directory()), 0o700);
    drop(private::create_file(&instance.config_path()).unwrap());
    assert_eq!(mode(&instance.config_path()), 0o600);
    assert_eq!(Instance::all_below(&base), [instance]);
}

#[test]
fn the_place_for_a_group_of_users_opens_nothing_else() {
    let scratch = Scratch::new("instance-gateway");
    let base = scratch.0.join("base");
    let instance = Instance::below(&base, "match").unwrap();
    instance.create_directory().unwrap();
    let group = rustix::process::getgid().as_raw();
    for _ in 0..2 {
        instance.create_gateway_directory(group).unwrap();
        let directory = instance.gateway_directory();
        assert_eq!((mode(&base), mode(instance.directory())), (0o711, 0o700));
        assert_eq!(mode(&directory), 0o710);
        assert_eq!(fs::metadata(&directory).unwrap().gid(), group);
    }
    assert_eq!(Instance::all_below(&base), std::slice::from_ref(&instance), "it is no instance");
    instance.remove_gateway_directory().unwrap();
    instance.remove_gateway_directory().unwrap();
    assert!(!instance.gateway_directory().exists() && instance.directory().exists());

    // For example a user's home.
    let home = scratch.0.join("home");
    fs::DirBuilder::new().mode(0o700).create(&home).unwrap();
    fs::write(home.join("letter"), "").unwrap();
    fs::set_permissions(home.join("letter"), fs::Permissions::from_mode(0o644)).unwrap();
    Instance::below(&home, "match").unwrap().create_gateway_directory(group).unwrap();
    assert_eq!(mode(&home), 0o700, "it was opened");

    let victim = scratch.0.join("victim");
    fs::create_dir(&victim).unwrap();
    let before = mode(&victim);
    std::os::unix::fs::symlink(&victim, instance.gateway_directory()).unwrap();
    let refusal = instance.create_gateway_directory(group).unwrap_err().to_string();
    assert!(refusal.contains("is a symbolic link"), "{refusal}");
    instance.remove_gateway_directory().unwrap();
    assert!(victim.exists() && mode(&victim) == before, "the link was followed");
}

#[test]
fn a_place_where_others_can_write_is_refused() {
    let scratch = Scratch::new("instance-open");
    let base = scratch.0.join("base");
    let instance = Instance::below(&base, "match").unwrap();
    instance.create_directory().unwrap();
    for path in [instance.directory(), &base] {
        fs::set_permissions(path, fs::Permissions::from_mode(0o777)).unwrap();
        let refusal = refusal(&instance);
        assert!(refusal.contains("can be written by other users"), "{refusal}");
        assert!(refusal.starts_with(&format!("{} ", path.display())), "{refusal}");
        fs::set_permissions(path, fs::Permissions::from_mode(0o700)).unwrap();
    }
    // Like /tmp.
    fs::set_permissions(&base, fs::Permissions::from_mode(0o1777)).unwrap();
    instance.create_directory().unwrap();
}

#[test]
fn links_and_files_in_the_place_of_the_directory_are_refused_and_not_followed() {
    let scratch = Scratch::new("instance-link");
    let victim = scratch.0.join("victim");
    fs::create_dir(&victim).unwrap();
    let base = scratch.0.join("base");
    std::os::unix::fs::symlink(&victim, &base).unwrap();
    let instance = Instance::below(&base, "match").unwrap();
    assert!(refusal(&instance).contains("is a symbolic link"));
    assert_eq!(fs::read_dir(&victim).unwrap().count(), 0, "the link was followed");

    fs::remove_file(&base).unwrap();
    fs::create_dir(&base).unwrap();
    for target in [&victim, &scratch.0.join("nothing")] {
        std::os::unix::fs::symlink(target, instance.directory()).unwrap();
        assert!(refusal(&instance).contains("is a symbolic link"));
        fs::remove_file(instance.directory()).unwrap();
    }
    fs::write(instance.directory(), "").unwrap();
    assert!(refusal(&instance).contains("is not a directory"));
}

#[test]
fn names_that_do_not_fit_into_file_names_are_refused() {
    for name in ["", "../x", "a b", "A", "äh", "x".repeat(MAX_NAME + 1).as_str()] {
        assert!(Instance::new(name).is_err(), "{name:?} was accepted");
    }
    assert!(Instance::new("match-2").is_ok());
}

#[test]
fn a_directory_that_was_there_before_stays() {
    let scratch = Scratch::new("instance-own");
    // The directories did not exist before.
    let base = scratch.0.join("base");
    let [first, second] = ["first", "second"].map(|name| Instance::below(&base, name).unwrap());
    for instance in [&first, &second] {
        instance.create_directory().unwrap();
        assert!(instance.has_files());
    }
    first.remove_directory().unwrap();
    assert!(!first.directory().exists() && second.directory().exists());
    second.remove_directory().unwrap();
    assert!(!base.exists());

    // The user has made the place, and a service manager the directory.
    let instance = Instance::below(&base, "match").unwrap();
    for path in [&base, instance.directory()] {
        fs::DirBuilder::new().mode(0o700).create(path).unwrap();
    }
    fs::write(instance.directory().join("notes"), "").unwrap();
    assert!(!instance.has_files(), "another directory of the user's");
    instance.create_directory().unwrap();
    for name in ["config.toml", "group.json", "control", "control-7", "supervisor.lock"] {
        fs::write(instance.directory().join(name), "").unwrap();
    }
    assert!(instance.has_files());
    instance.remove_directory().unwrap();
    let left: Vec<_> = fs::read_dir(instance.directory()).unwrap().flatten().collect();
    assert_eq!(left.len(), 1, "{left:?}");
    assert_eq!(left[0].file_name(), "notes");
}

#[test]
fn a_place_that_others_can_exchange_is_refused_before_anything_is_made() {
    let scratch = Scratch::new("instance-way");
    let open = scratch.0.join("open");
    fs::create_dir(&open).unwrap();
    fs::set_permissions(&open, fs::Permissions::from_mode(0o777)).unwrap();
    let instance = Instance::below(&open.join("base"), "match").unwrap();
    let refusal = refusal(&instance);
    assert!(refusal.contains("can be written by other users, who could put"), "{refusal}");
    assert!(refusal.contains("chmod go-w") && refusal.contains(RUNTIME_DIR_VARIABLE), "{refusal}");
    assert_eq!(fs::read_dir(&open).unwrap().count(), 0);
}
