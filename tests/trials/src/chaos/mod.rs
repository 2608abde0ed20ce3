//! `touchline chaos`: starts a match, disturbs it at random, and checks every promise.
//!
//! * [`plan`]: the random sequence of disturbances, repeatable by its seed.
//! * [`group`]: the match, which is the real program in its own processes.
//! * [`bystanders`]: programs that attach to it and behave badly.
//! * [`outsider`]: another user who takes names and tries to gain access.
//! * [`vandal`]: a program that publishes invalid messages.
//! * [`shortage`]: temporary lack of descriptors or of shared memory.
//! * [`population`]: the living processes, and signals to them and no others.
//! * [`observer`]: independent subscribers; [`tally`] counts what they receive.
//! * [`leaks`]: resources used before and after, and those left at the end.
//! * [`report`] and [`verdict`]: the figures, and the promises kept.

mod bystanders;
mod group;
mod leaks;
mod observer;
mod outsider;
mod plan;
mod population;
mod report;
mod shortage;
mod tally;
mod vandal;
mod verdict;

pub use bystanders::attach;
pub use plan::Disturbance;

use crate::TrialError;
use crate::args::ChaosArgs;
use bystanders::Bystanders;
use client::clock::{monotonic_ns, wall_ns};
use config::Config;
use control::Report;
use group::{Group, LAST_WORDS, PATIENCE};
use leaks::Usage;
use messages::ProcessKind;
use observer::Observer;
use outsider::{Deeds, Outsider};
use plan::{Plan, Step};
use population::{Population, listens_to, panics_on_command};
use report::{ChaosReport, Done, Ended, Frames, Settings, Times, ms};
use runtime::output::Rule;
use rustix::process::Signal;
use shortage::Shortage;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vandal::Vandal;

/// Time between two rounds of the main loop.
const TICK: Duration = Duration::from_millis(1);
/// Undisturbed time before the first disturbance, for comparison.
const WARM_UP: Duration = Duration::from_secs(2);
/// Shortest undisturbed time after the last disturbance, so that frames under way arrive.
const SETTLE: Duration = Duration::from_millis(1500);
/// Resources still in use after this time are a leak.
const SETTLED: Duration = Duration::from_secs(10);
/// A stage that cannot be disturbed again within this time has not recovered.
const COMES_BACK: Duration = Duration::from_secs(10);
/// A frame that has not reached `world` after this time is lost.
const LOST_AFTER_NS: u64 = 1_000_000_000;

/// Longest log that goes into the report.
const WHOLE_LOG: usize = 1 << 20;

/// Runs a match and disturbs it.
pub fn chaos(args: ChaosArgs) -> Result<ExitCode, TrialError> {
    let mut config = runtime::user_config::load_config(args.config.as_deref())?;
    if let Some(fps) = args.fps {
        config.camera.fps = fps;
    }
    let has_outsider = args.signals.contains(&Disturbance::Outsider);
    if has_outsider {
        outsider::check()?;
    }
    if has_outsider || args.signals.contains(&Disturbance::Enospc) {
        shortage::enter_own_place(&config, &args.source)?;
    }
    let report_file = match &args.report {
        None => None,
        Some(path) => {
            let inputs: Vec<&Path> = args.config.iter().map(|path| &**path).collect();
            Some(Rule { inputs: &inputs, force: false }.create_report(path)?)
        }
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in
        [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP]
    {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }

    let settings = settings(&args, &config);
    say(&format!(
        "{} to {} every {} ms for {} s, {} frames a second, --seed {}",
        list(settings.signals.iter().map(|kind| kind.name())),
        list(settings.stages.iter().map(|kind| kind.name())),
        settings.every_ms,
        settings.seconds,
        settings.fps,
        settings.seed
    ));
    // The first one starts before the match, when the match's names appear for the first time.
    let early = match has_outsider {
        true => Some(Outsider::start(None, Instant::now() + PATIENCE)?),
        false => None,
    };
    let group = Group::start(args.config.as_deref(), &args.source, settings.fps, settings.seconds)?;
    let mut session = Session::new(group, settings, stop)?;
    session.outsiders.extend(early);
    session.warm_up()?;
    session.disturb()?;
    session.settle()?;
    let report = session.finish()?;

    say(verdict::text(&report).trim_end());
    if let Some(file) = report_file {
        serde_json::to_writer_pretty(&file, &report)?;
    }
    Ok(if report.kept { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn settings(args: &ChaosArgs, config: &Config) -> Settings {
    let supervisor = &config.supervisor;
    let mut signals = args.signals.clone();
    signals.sort();
    signals.dedup();
    let mut stages = args.stages.clone();
    stages.sort();
    stages.dedup();
    Settings {
        seconds: args.seconds,
        every_ms: args.every,
        signals,
        stages,
        fps: config.camera.fps,
        bystanders: args.bystanders,
        seed: args.seed.unwrap_or_else(|| wall_ns() / 1_000_000 % 1_000_000),
        stall_deadline_ms: (supervisor.stall_frames * 1000.0 / config.camera.fps)
            .max(supervisor.stall_min_ms),
        spares: supervisor.spares.iter().map(|&stage| stage.into()).collect(),
    }
}

/// Prints a line; the match continues if the reader is gone (`| head`).
fn say(line: &str) {
    let _ = runtime::say_line!("{line}");
}

fn list<'a>(words: impl Iterator<Item = &'a str>) -> String {
    words.collect::<Vec<_>>().join(",")
}

/// A match under test.
struct Session {
    settings: Settings,
    stop: Arc<AtomicBool>,
    // Before the group: the observer must detach before the group ends.
    observer: Observer,
    bystanders: Option<Bystanders>,
    fate: Option<bystanders::Fate>,
    group: Group,
    population: Population,
    began_ns: u64,
    calm: Option<(u64, u64)>,
    lost_undisturbed: u64,
    usage_before: Usage,
    usage_after: Usage,
    done: Vec<Done>,
    left_out: u64,
    supervisor_failure: Option<String>,
    ended_by_themselves: Vec<Ended>,
    deaths: u64,
    shortages: Vec<Shortage>,
    vandals: Vec<Vandal>,
    outsiders: Vec<Outsider>,
    deeds: Deeds,
    line_at: Instant,
}

impl Session {
    fn new(group: Group, settings: Settings, stop: Arc<AtomicBool>) -> Result<Self, TrialError> {
        let observer = Observer::start(&group.instance, settings.fps)?;
        Ok(Self {
            population: Population::new(group.instance.name()),
            settings,
            stop,
            observer,
            bystanders: None,
            fate: None,
            group,
            began_ns: monotonic_ns(),
            calm: None,
            lost_undisturbed: 0,
            usage_before: Usage::default(),
            usage_after: Usage::default(),
            done: Vec::new(),
            left_out: 0,
            supervisor_failure: None,
            ended_by_themselves: Vec::new(),
            deaths: 0,
            shortages: Vec::new(),
            vandals: Vec::new(),
            outsiders: Vec::new(),
            deeds: Deeds::default(),
            line_at: Instant::now(),
        })
    }

    /// Waits until all processes are present, then observes the undisturbed match for a while.
    fn warm_up(&mut self) -> Result<(), TrialError> {
        let deadline = Instant::now() + PATIENCE;
        while !self.is_complete() && !self.is_stopped() {
            if Instant::now() > deadline {
                return Err(format!(
                    "the group does not get ready:\n{}",
                    self.group.log(LAST_WORDS)
                )
                .into());
            }
            self.look()?;
        }
        if self.settings.signals.contains(&Disturbance::Panic) {
            for &stage in &self.settings.stages {
                if self.population.active(stage).is_some_and(|pid| !panics_on_command(pid)) {
                    return Err(format!(
                        "the {} does not know how to panic on command",
                        stage.name()
                    )
                    .into());
                }
            }
        }
        self.end_outsiders(|_| true);
        let calm_ns = monotonic_ns();
        self.watch_for(WARM_UP)?;
        self.calm = Some((calm_ns, monotonic_ns()));
        self.usage_before = leaks::usage(&self.group.instance);
        self.lost_undisturbed = self.lost_so_far();
        if self.lost_undisturbed > 0 {
            say(&verdict::too_slow(self.lost_undisturbed, self.settings.fps));
        }
        Ok(())
    }

    /// Frames not captured, not in `world` or not seen by the observer, from the start until now.
    fn lost_so_far(&self) -> u64 {
        let sight = self.observer.sight();
        let missing =
            sight.tally.missing(monotonic_ns().saturating_sub(LOST_AFTER_NS)).len() as u64;
        let gaps: u64 = sight.tally.gaps().iter().map(|gap| gap.frames).sum();
        missing + gaps + sight.tally.overlooked()
    }

    fn disturb(&mut self) -> Result<(), TrialError> {
        let plan = Plan::new(
            self.settings.seed,
            Duration::from_millis(self.settings.every_ms),
            self.settings.signals.clone(),
            self.settings.stages.clone(),
        );
        if self.settings.bystanders {
            self.bystanders = Some(Bystanders::start(&self.group.instance)?);
        }
        self.began_ns = monotonic_ns();
        let began = Instant::now();
        let end = began + Duration::from_secs_f64(self.settings.seconds);
        // A delayed disturbance delays all later ones, so the pace stays.
        let mut slip = Duration::ZERO;
        for step in plan {
            while Instant::now() < (began + step.at + slip).min(end) && !self.is_stopped() {
                self.look()?;
            }
            let due = Instant::now();
            if due >= end {
                break;
            }
            while !self.is_stopped() && !self.carry_out(&step, due)? {
                if due.elapsed() > COMES_BACK {
                    self.left_out += 1;
                    break;
                }
                self.look()?;
            }
            slip += due.elapsed();
            if self.is_stopped() {
                break;
            }
        }
        self.shortages.clear();
        self.vandals.clear();
        self.end_outsiders(|_| true);
        self.fate = self.bystanders.take().map(|bystanders| bystanders.fate);
        Ok(())
    }

    /// Carries out a planned disturbance; `false` if that is not possible yet. A stage that promises to
    /// lose nothing is disturbed only when it has a spare: anything else is a double fault.
    fn carry_out(&mut self, step: &Step, due: Instant) -> Result<bool, TrialError> {
        let waited_ms = ms(due.elapsed().as_nanos() as u64);
        let t_ns;
        let pid;
        let has_spare = step.stage.is_none_or(|stage| self.settings.spares.contains(&stage));
        match step.stage {
            None => {
                pid = self.group.supervisor_pid();
                // A supervisor that has just been started is not ready yet.
                let is_there = listens_to(pid, Signal::HUP) && self.group.instance.is_supervised();
                if !self.is_complete() || !is_there {
                    return Ok(false);
                }
                t_ns = monotonic_ns();
                let until = Instant::now() + step.pause;
                match step.what {
                    Disturbance::Hup => self.group.signal_supervisor(Signal::HUP),
                    Disturbance::Reload => {
                        if !self.group.reload()? {
                            return Ok(false);
                        }
                    }
                    Disturbance::Emfile => {
                        self.shortages.push(Shortage::of_descriptors(pid, until)?);
                    }
                    Disturbance::Enospc => self.shortages.push(Shortage::of_shared_memory(until)?),
                    Disturbance::Rubbish => {
                        self.vandals.push(Vandal::start(&self.group.instance, step.pause)?);
                    }
                    Disturbance::Outsider => {
                        self.outsiders.push(Outsider::start(Some(&self.group.instance), until)?);
                    }
                    _ => {
                        // A new supervisor would have to start without descriptors or memory.
                        self.shortages.clear();
                        self.group.replace_supervisor()?;
                    }
                }
            }
            Some(stage) => {
                let Some(active) = self.population.active(stage) else { return Ok(false) };
                let spare = self.population.spare(stage);
                if has_spare && spare.is_none() {
                    return Ok(false);
                }
                t_ns = monotonic_ns();
                pid = active;
                let people = &mut self.population;
                match step.what {
                    Disturbance::Restart => {
                        if !self.group.restart(stage)? {
                            return Ok(false);
                        }
                        people.expect_end(active);
                    }
                    Disturbance::Kill => people.kill(active),
                    Disturbance::Stop => people.stop(active),
                    Disturbance::Pause => people.pause(active, Instant::now() + step.pause),
                    Disturbance::Panic => people.panic(active),
                    Disturbance::Double => {
                        spare.into_iter().for_each(|spare| people.kill(spare));
                        people.kill(active);
                    }
                    Disturbance::Supervisor
                    | Disturbance::Hup
                    | Disturbance::Reload
                    | Disturbance::Emfile
                    | Disturbance::Enospc
                    | Disturbance::Rubbish
                    | Disturbance::Outsider => unreachable!("these have no stage"),
                }
            }
        }
        self.done.push(Done {
            t_ns,
            t_s: ms(t_ns.saturating_sub(self.began_ns)) / 1000.0,
            what: step.what,
            stage: step.stage,
            pid,
            pause_ms: step.what.lasts().then(|| ms(step.pause.as_nanos() as u64)),
            waited_ms,
            lossless: has_spare && step.what != Disturbance::Double,
            next_world_ms: None,
            fresh_world_ms: None,
            protected_ms: None,
        });
        Ok(true)
    }

    /// Waits until the group has recovered, or until it is clear that it will not.
    fn settle(&mut self) -> Result<(), TrialError> {
        let began = Instant::now();
        let mut look_at = began + SETTLE;
        while self.supervisor_failure.is_none() && began.elapsed() < SETTLED {
            self.look()?;
            if Instant::now() < look_at {
                continue;
            }
            look_at = Instant::now() + Duration::from_millis(100);
            self.usage_after = leaks::usage(&self.group.instance);
            if self.is_complete() && self.usage_after.is_back_to(&self.usage_before) {
                break;
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<ChaosReport, TrialError> {
        let group_says = match &self.supervisor_failure {
            None => self.group.status(),
            Some(_) => None,
        };
        let sight = self.observer.finish();
        if let Some(failure) = &sight.failure {
            return Err(format!("the observer could not go on: {failure}").into());
        }
        let group_log = self.group.log(WHOLE_LOG).lines().map(Into::into).collect();
        let left = self.group.end();
        let tally = &sight.tally;

        let mut done = self.done;
        for done in &mut done {
            let outage = tally.outage(done.t_ns);
            done.next_world_ms = outage.next_world_ns.map(ms);
            done.fresh_world_ms = outage.fresh_world_ns.map(ms);
        }
        let ended = |group: &Report| group.stages.values().map(|stage| stage.restarts).sum::<u64>();
        let started_in_vain = match &group_says {
            // A new supervisor counts from zero, and without memory no process starts.
            Some(group)
                if done.iter().all(|done| {
                    !matches!(done.what, Disturbance::Supervisor | Disturbance::Enospc)
                }) =>
            {
                ended(group).saturating_sub(self.deaths)
            }
            _ => 0,
        };
        let missing = tally.missing(monotonic_ns().saturating_sub(LOST_AFTER_NS));
        let mut report = ChaosReport {
            version: env!("CARGO_PKG_VERSION"),
            kept: false,
            promises: Vec::new(),
            interrupted: self.stop.load(Ordering::Relaxed),
            frames: Frames::new(&sight, &missing, &done),
            times_ms: times(&done, tally, self.calm),
            disturbances: done,
            lost_undisturbed: self.lost_undisturbed,
            left_out: self.left_out,
            supervisor_failure: self.supervisor_failure,
            ended_by_themselves: self.ended_by_themselves,
            started_in_vain,
            observer_longest_absence_ms: ms(sight.longest_absence_ns),
            usage_before: self.usage_before,
            usage_after: self.usage_after,
            left,
            group: group_says,
            group_log,
            bystanders: self.fate,
            outsider: self.settings.signals.contains(&Disturbance::Outsider).then_some(self.deeds),
            settings: self.settings,
        };
        report.promises = verdict::judge(&report);
        report.kept =
            !report.disturbances.is_empty() && report.promises.iter().all(|promise| promise.kept);
        Ok(report)
    }

    fn watch_for(&mut self, time: Duration) -> Result<(), TrialError> {
        let end = Instant::now() + time;
        while Instant::now() < end && !self.is_stopped() {
            self.look()?;
        }
        Ok(())
    }

    /// One round: heartbeats, deaths, pauses to be ended, and the clock.
    fn look(&mut self) -> Result<(), TrialError> {
        std::thread::sleep(TICK);
        match self.group.check() {
            Ok(()) => {}
            // Before the first disturbance there is nothing to report.
            Err(error) if self.done.is_empty() => return Err(error),
            Err(error) => self.supervisor_failure = Some(error.to_string()),
        }
        for beat in self.observer.heartbeats.try_iter() {
            self.population.note(&beat);
        }
        self.population.resume(Instant::now());
        self.shortages.retain(|shortage| !shortage.is_over(Instant::now()));
        self.vandals.retain_mut(|vandal| !vandal.has_ended());
        let now = Instant::now();
        self.end_outsiders(|outsider| outsider.is_over(now));
        if let Some(bystanders) = &mut self.bystanders {
            bystanders.look()?;
        }
        let now_ns = monotonic_ns();
        for death in self.population.take_ended() {
            self.deaths += 1;
            if !death.provoked && !self.group.is_outdated(death.kind, death.revision) {
                let t_s = ms(now_ns.saturating_sub(self.began_ns)) / 1000.0;
                self.ended_by_themselves.push(Ended { stage: death.kind, pid: death.pid, t_s });
            }
        }
        for done in self.done.iter_mut().filter(|done| done.protected_ms.is_none()) {
            let replaced = done.what.concerns_a_stage() && done.what != Disturbance::Pause;
            let Some(stage) = done.stage.filter(|stage| self.settings.spares.contains(stage))
            else {
                continue;
            };
            let protected =
                self.population.active(stage).is_some() && self.population.spare(stage).is_some();
            if replaced && protected {
                done.protected_ms = Some(ms(now_ns - done.t_ns));
            }
        }
        if self.line_at.elapsed() >= Duration::from_secs(1) && !self.done.is_empty() {
            self.line_at = Instant::now();
            self.print_line(now_ns);
        }
        Ok(())
    }

    /// Ends the outsiders for which `is_over` holds, and adds up their deeds.
    fn end_outsiders(&mut self, is_over: impl Fn(&mut Outsider) -> bool) {
        for outsider in self.outsiders.extract_if(.., is_over) {
            self.deeds = self.deeds.and(outsider.end());
        }
    }

    fn print_line(&self, now_ns: u64) {
        let sight = self.observer.sight();
        let tally = &sight.tally;
        let missing = tally.missing(now_ns.saturating_sub(LOST_AFTER_NS)).len();
        let outages = self.done.iter().filter_map(|done| tally.outage(done.t_ns).fresh_world_ns);
        let outage = Times::of(outages.map(ms)).unwrap_or_default();
        say(&format!(
            "{:4.0} s  {:4} disturbances  {:6} frames, {missing} missing, {} twice, {} out of order  \
             outage median {:.1} ms, longest {:.1}",
            (now_ns - self.began_ns) as f64 / 1e9,
            self.done.len(),
            tally.frames_captured(),
            tally.order().duplicates().len(),
            tally.order().out_of_order().len(),
            outage.median,
            outage.max
        ));
    }

    /// Whether every stage has an active process and every configured spare is ready.
    fn is_complete(&self) -> bool {
        ProcessKind::ALL.iter().all(|&kind| self.population.active(kind).is_some())
            && self.settings.spares.iter().all(|&kind| self.population.spare(kind).is_some())
    }

    /// Whether to stop early.
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.supervisor_failure.is_some()
    }
}

/// Distributions of times by name. The undisturbed outages are the waits of a reader that starts at a
/// random time: no disturbance can be felt for less.
fn times(done: &[Done], tally: &tally::Tally, calm: Option<(u64, u64)>) -> BTreeMap<String, Times> {
    /// Not a multiple of any usual frame period.
    const CALM_STEP_NS: usize = 7_310_000;
    /// Left out at the end of the calm, so that no wait reaches beyond it.
    const CALM_END_NS: u64 = 200_000_000;
    let mut times = BTreeMap::new();
    let mut put = |name: String, values: Vec<f64>| {
        if let Some(of_them) = Times::of(values) {
            times.insert(name, of_them);
        }
    };
    if let Some((from_ns, to_ns)) = calm {
        let moments = || (from_ns..to_ns.saturating_sub(CALM_END_NS)).step_by(CALM_STEP_NS);
        let next = moments().filter_map(|t| tally.outage(t).next_world_ns.map(ms));
        put(verdict::next_name("(undisturbed)"), next.collect());
        let fresh = moments().filter_map(|t| tally.outage(t).fresh_world_ns.map(ms));
        put(verdict::fresh_name("(undisturbed)"), fresh.collect());
        put("between two worlds".into(), tally.intervals_ns(to_ns).map(ms).collect());
    }
    let mut labels: Vec<String> = done.iter().map(Done::label).collect();
    labels.sort();
    labels.dedup();
    for label in labels {
        let alike = || done.iter().filter(|done| done.label() == label);
        let next = alike().filter_map(|done| done.next_world_ms);
        put(verdict::next_name(&label), next.collect());
        let fresh = alike().filter_map(|done| done.fresh_world_ms);
        put(verdict::fresh_name(&label), fresh.collect());
    }
    put(
        "until there is a spare again".into(),
        done.iter().filter_map(|done| done.protected_ms).collect(),
    );
    put(
        "waited for a spare".into(),
        done.iter().map(|done| done.waited_ms).filter(|&ms| ms > 2.0).collect(),
    );
    times
}
