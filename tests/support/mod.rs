//! Starts the real program and observes it from outside.
//!
//! Every group has a runtime directory of its own, so groups never meet and leftovers are found. Only
//! one group runs at a time, because two of them on a small machine would distort each other's
//! measurements. Whatever happens in a test, dropping the [`Group`] ends every process it started.
#![allow(dead_code)] // each test program uses its own part of this

use client::instance::{Instance, Namespace};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Generous: a busy machine is slow, but not stuck.
pub const PATIENCE: Duration = Duration::from_secs(60);

static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A directory that is removed at the end of the test, unless `TOUCHLINE_KEEP_SCRATCH` is set for
/// inspection.
pub struct Scratch {
    pub path: PathBuf,
}

impl Scratch {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self { path }
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path.join(name);
        fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if std::env::var_os("TOUCHLINE_KEEP_SCRATCH").is_some() {
            return;
        }
        let _ = fs::remove_dir_all(&self.path);
    }
}

/// The program, with its runtime directory below `scratch`.
pub fn touchline(scratch: &Scratch, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_touchline"));
    command.args(args).env("TOUCHLINE_RUNTIME_DIR", scratch.path.join("run"));
    // Tests of the console start it by a configuration; the other groups would compete for its port.
    command.env("TOUCHLINE_NO_CONSOLE", "1");
    command.stdin(Stdio::null());
    command
}

/// Runs the program to its end.
pub fn output_of(scratch: &Scratch, args: &[&str]) -> Output {
    touchline(scratch, args).output().unwrap()
}

/// A group started by a test.
pub struct Group {
    pub scratch: Scratch,
    pub instance: Instance,
    supervisor: Child,
    arguments: Vec<String>,
    /// Stage processes seen so far, so that they can be ended even if the supervisor cannot do it.
    seen: Vec<u32>,
    /// Its names in shared memory, as seen so far.
    namespaces: Vec<Namespace>,
    _turn: MutexGuard<'static, ()>,
}

impl Group {
    /// Starts `touchline run` with these additional arguments. Stages without a supervisor end soon, so
    /// that a failing test leaves nothing behind.
    pub fn start(name: &str, config: &str, args: &[&str]) -> Self {
        Self::start_with(name, config, args, &[])
    }

    /// Like [`start`](Self::start), with variables in the environment of all its processes.
    pub fn start_with(name: &str, config: &str, args: &[&str], variables: &[(&str, &str)]) -> Self {
        Self::start_changed(name, config, args, |supervisor| {
            supervisor.envs(variables.iter().copied());
        })
    }

    /// Like [`start`](Self::start), without a variable in the environment of its processes.
    pub fn start_without(name: &str, config: &str, variable: &str) -> Self {
        Self::start_changed(name, config, &[], |supervisor| {
            supervisor.env_remove(variable);
        })
    }

    /// Like [`start`](Self::start), but with unread output, as if the terminal were gone.
    pub fn start_unheard(name: &str) -> Self {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        Self::start_changed(name, "", &[], |supervisor| {
            supervisor.stdout(writer.try_clone().unwrap()).stderr(writer);
        })
    }

    /// Like [`start`](Self::start), but all output goes into this pipe.
    pub fn start_speaking_to(name: &str, writer: std::io::PipeWriter) -> Self {
        Self::start_changed(name, "", &[], |supervisor| {
            supervisor.stdout(writer.try_clone().unwrap()).stderr(writer);
        })
    }

    fn start_changed(
        name: &str,
        config: &str,
        args: &[&str],
        change: impl FnOnce(&mut Command),
    ) -> Self {
        let turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let scratch = Scratch::new(name);
        let config = if config.contains("[supervisor]") {
            config.to_string()
        } else {
            format!("{config}\n[supervisor]\norphan_timeout_s = 3\n")
        };
        let config = scratch.write("config.toml", &config);
        let instance = Instance::below(&scratch.path.join("run"), "test").unwrap();
        let base = ["run", "--instance", "test", "--config", config.to_str().unwrap()];
        let arguments: Vec<String> =
            base.iter().chain(args).map(|argument| argument.to_string()).collect();
        let mut supervisor = Self::command(&scratch, &arguments);
        change(&mut supervisor);
        let supervisor = supervisor.spawn().unwrap();
        let (seen, namespaces) = Default::default();
        Self { scratch, instance, supervisor, arguments, seen, namespaces, _turn: turn }
    }

    /// Starts `touchline run` with these arguments only.
    pub fn start_plain(name: &str, args: &[&str]) -> Self {
        let base = ["run", "--instance", "test"];
        Self::start_in(Scratch::new(name), &[&base, args].concat(), |_| ())
    }

    /// Starts `touchline console` with these arguments only, in a directory that may have files already.
    pub fn start_console(scratch: Scratch, args: &[&str]) -> Self {
        let base = ["console", "--instance", "test"];
        Self::start_in(scratch, &[&base, args].concat(), |supervisor| {
            supervisor.env_remove("TOUCHLINE_NO_CONSOLE");
        })
    }

    fn start_in(scratch: Scratch, args: &[&str], change: impl FnOnce(&mut Command)) -> Self {
        let turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let instance = Instance::below(&scratch.path.join("run"), "test").unwrap();
        let arguments: Vec<String> = args.iter().map(|argument| argument.to_string()).collect();
        let mut supervisor = Self::command(&scratch, &arguments);
        change(&mut supervisor);
        let supervisor = supervisor.spawn().unwrap();
        let (seen, namespaces) = Default::default();
        Self { scratch, instance, supervisor, arguments, seen, namespaces, _turn: turn }
    }

    fn command(scratch: &Scratch, arguments: &[String]) -> Command {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let mut command = touchline(scratch, &arguments);
        command
            .env("XDG_STATE_HOME", scratch.path.join("state"))
            .stdout(Stdio::null())
            .stderr(fs::File::create(scratch.path.join("stderr")).unwrap());
        command
    }

    /// Kills only the supervisor, and starts another one with the same arguments.
    pub fn replace_supervisor(&mut self) {
        let arguments = self.arguments.clone();
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        self.replace_supervisor_by(&arguments);
    }

    /// Like [`replace_supervisor`](Self::replace_supervisor), with variables in its environment.
    pub fn replace_supervisor_with(&mut self, variables: &[(&str, &str)]) {
        self.kill_supervisor();
        let mut command = Self::command(&self.scratch, &self.arguments);
        self.supervisor = command.envs(variables.iter().copied()).spawn().unwrap();
    }

    /// Kills only the supervisor, if it lives.
    pub fn kill_supervisor(&mut self) {
        // It may be dead already.
        let _ = self.supervisor.kill();
        self.supervisor.wait().unwrap();
    }

    /// Kills only the supervisor, if it lives, and starts the program with these arguments.
    pub fn replace_supervisor_by(&mut self, arguments: &[&str]) {
        self.kill_supervisor();
        let arguments: Vec<String> = arguments.iter().map(|text| text.to_string()).collect();
        self.supervisor = Self::command(&self.scratch, &arguments).spawn().unwrap();
    }

    /// Runs a subcommand on this group to its end.
    pub fn touchline(&self, args: &[&str]) -> Output {
        self.start_touchline(args).wait_with_output().unwrap()
    }

    /// Starts a subcommand on this group.
    pub fn start_touchline(&self, args: &[&str]) -> Child {
        let mut command = touchline(&self.scratch, args);
        command.args(["--instance", "test"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// The report of the running group; `None` while there is none.
    pub fn try_status(&mut self) -> Option<Value> {
        let output = output_of(&self.scratch, &["status", "--instance", "test", "--json"]);
        let status: Value = serde_json::from_slice(&output.stdout).ok()?;
        let namespace = self.instance.namespace().unwrap();
        self.namespaces.extend(namespace.filter(|it| !self.namespaces.contains(it)));
        for stage in status["stages"].as_object()?.values() {
            for process in stage["processes"].as_array()? {
                let pid = process["pid"].as_u64()? as u32;
                if !self.seen.contains(&pid) {
                    self.seen.push(pid);
                }
            }
        }
        Some(status)
    }

    /// Waits until the group's report satisfies a condition, and returns it.
    pub fn wait_for(&mut self, what: &str, condition: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + PATIENCE;
        let mut last = None;
        while Instant::now() < deadline {
            if let Some(status) = self.try_status() {
                if condition(&status) {
                    return status;
                }
                last = Some(status);
            }
            if let Ok(Some(end)) = self.supervisor.try_wait() {
                panic!("waiting for {what}, but the supervisor ended: {end}\n{}", self.stderr());
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        let output = output_of(&self.scratch, &["status", "--instance", "test"]);
        panic!("{what} did not happen; last status {last:#?}\n{}\n{output:?}", self.stderr());
    }

    /// Waits until every stage works and publishes results.
    pub fn wait_until_working(&mut self) -> Value {
        self.wait_for("a working group", |status| {
            status["complete"] == true && status["frames"]["world"].as_u64() > Some(5)
        })
    }

    /// The running group's names in shared memory.
    pub fn namespace(&self) -> Namespace {
        self.instance.namespace().unwrap().expect("the group runs")
    }

    /// Process id of a stage's active process.
    pub fn pid_of(status: &Value, stage: &str) -> u32 {
        status["stages"][stage]["processes"]
            .as_array()
            .unwrap()
            .iter()
            .find(|process| process["state"] == "active")
            .unwrap_or_else(|| panic!("no active {stage} in {status:#?}"))["pid"]
            .as_u64()
            .unwrap() as u32
    }

    /// Sends a signal. After [`Signal::STOP`], waits until the process has stopped: each of its threads
    /// continues until it is scheduled again.
    pub fn signal(&self, pid: u32, signal: Signal) {
        kill_process(Pid::from_raw(pid as i32).unwrap(), signal).unwrap();
        let deadline = Instant::now() + PATIENCE;
        while signal == Signal::STOP && runs(pid) {
            assert!(Instant::now() < deadline, "process {pid} does not stop");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Process id of the supervisor.
    pub fn supervisor_pid(&self) -> u32 {
        self.supervisor.id()
    }

    /// Asserts that the supervisor has not ended.
    pub fn assert_running(&mut self) {
        if let Ok(Some(end)) = self.supervisor.try_wait() {
            panic!("the supervisor ended: {end}\n{}", self.stderr());
        }
    }

    pub fn signal_supervisor(&self, signal: Signal) {
        self.signal(self.supervisor.id(), signal);
    }

    /// Waits until the supervisor has ended by itself.
    pub fn wait_until_ended(&mut self) -> std::process::ExitStatus {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            if let Some(status) = self.supervisor.try_wait().unwrap() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the group did not end\n{}", self.stderr());
    }

    pub fn stderr(&self) -> String {
        fs::read_to_string(self.scratch.path.join("stderr")).unwrap_or_default()
    }

    /// Asserts that nothing of the group is left: no process, no shared memory, no file.
    pub fn assert_nothing_left(&self) {
        for &pid in &self.seen {
            assert!(!is_stage(pid), "process {pid} is still there");
        }
        assert_eq!(self.instance.namespace().unwrap(), None, "shared memory left behind");
        for namespace in &self.namespaces {
            let left = shared_memory(namespace);
            assert_eq!(left, Vec::<PathBuf>::new(), "shared memory left behind");
        }
        let directory = self.instance.directory();
        assert!(!directory.exists(), "{} is left behind", directory.display());
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        let running = |child: &mut Child| matches!(child.try_wait(), Ok(None));
        if running(&mut self.supervisor) {
            self.signal_supervisor(Signal::CONT);
            self.signal_supervisor(Signal::TERM);
            let deadline = Instant::now() + Duration::from_secs(10);
            while running(&mut self.supervisor) && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(20));
            }
            let _ = self.supervisor.kill();
        }
        let _ = self.supervisor.wait();
        for &pid in self.seen.iter().filter(|&&pid| is_stage(pid)) {
            let _ = kill_process(Pid::from_raw(pid as i32).unwrap(), Signal::KILL);
        }
        let now = self.instance.namespace().ok().flatten();
        for path in self.namespaces.iter().chain(&now).flat_map(shared_memory) {
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
        }
    }
}

/// Whether a process with this id lives and is one of ours; ids are reused.
pub fn is_stage(pid: u32) -> bool {
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    name.starts_with("tl-") && !stat.contains(") Z ")
}

/// Whether any thread of a process is neither stopped nor ended.
fn runs(pid: u32) -> bool {
    let threads = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    threads.into_iter().any(|thread| {
        let stat = fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        // After the name, which is in brackets and may contain any character.
        let state = stat.rsplit_once(") ").map(|(_, rest)| rest.as_bytes()[0]);
        !matches!(state, None | Some(b'T' | b'Z' | b'X'))
    })
}

/// A group's files in shared memory: its directory, and the segments beside it.
pub fn shared_memory(namespace: &Namespace) -> Vec<PathBuf> {
    let (mut paths, _) = namespace.segments().unwrap();
    let directory = namespace.directory();
    paths.extend(directory.exists().then(|| directory.to_path_buf()));
    paths
}
