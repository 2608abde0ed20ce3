//! `/metrics`: the group's report in Prometheus' text format.

use super::answer::{self, Failure};
use super::app::App;
use super::desk::Kind;
use super::routes::newest;
use axum::extract::State;
use axum::response::Response;
use control::Report;
use control::report::Percentiles;
use std::fmt::Write as _;
use std::sync::Arc;

/// The type of version 0.0.4 of the format.
const MIME: &str = "text/plain; version=0.0.4; charset=utf-8";

/// `/metrics`
pub async fn metrics(State(app): State<Arc<App>>) -> Result<Response, Failure> {
    let silent = || Failure::unavailable("the group's supervisor says nothing");
    let news = newest(&app, Kind::Status).await.ok_or_else(silent)?;
    let report: Report = serde_json::from_str(&news.text).map_err(|_| silent())?;
    Ok(answer::text(MIME, of(&report)))
}

/// The report as text.
fn of(report: &Report) -> String {
    let mut text = Text { words: String::new(), instance: label(&report.instance) };
    let frames = &report.frames;
    text.counter("frames_captured_total", "Frames from the camera.", frames.captured);
    text.counter(
        "frames_never_captured_total",
        "Numbers that the camera left out.",
        frames.never_captured,
    );
    text.counter(
        "frames_dropped_total",
        "Frames that the grabber dropped.",
        frames.dropped_by_grabber,
    );
    text.counter("world_total", "Frames with poses.", frames.world);
    text.counter("world_missing_total", "Captured frames without poses.", frames.missing_in_world);
    text.gauge("complete", "1 when every stage works.", f64::from(u8::from(report.complete)));
    text.gauge("elapsed_seconds", "Time the group has been running.", report.elapsed_s);
    text.gauge(
        "captured_per_second",
        "Frames a second over the last second.",
        report.rate.captured,
    );
    text.gauge("world_per_second", "Poses a second over the last second.", report.rate.world);
    text.gauge("robots_found", "Robots in the newest frame.", report.found.robots as f64);
    text.gauge(
        "robots_configured",
        "Robots that may be on the pitch.",
        report.found.robots_configured as f64,
    );
    text.gauge("ball_found", "1 when the ball is seen.", f64::from(u8::from(report.found.ball)));
    text.gauge(
        "memory_bytes",
        "Memory of the group, shared memory once.",
        report.resources.memory_bytes as f64,
    );
    text.gauge(
        "pipeline_cpu_percent",
        "Processor use without the grabber.",
        report.resources.pipeline_cpu_percent,
    );
    text.gauge(
        "configuration_revision",
        "Revision of the configuration.",
        report.configuration.revision.into(),
    );
    text.gauge("events", "Kept observations of the supervisor.", report.events.len() as f64);
    let latency = &report.latency_us;
    text.begin("latency_microseconds", "From the middle of the exposure to an output.", "summary");
    for (stage, percentiles) in [
        ("grabber", &latency.capture_to_frame),
        ("classifier", &latency.capture_to_runs),
        ("tracker", &latency.capture_to_detections),
        ("filter", &latency.capture_to_world),
    ] {
        text.quantiles("latency_microseconds", stage, percentiles);
    }
    type Counter = fn(&control::report::Stage) -> f64;
    let counters: [(&str, &str, &str, Counter); 5] = [
        ("stage_frames_in_total", "Inputs of a stage.", "counter", |it| it.frames_in as f64),
        ("stage_frames_out_total", "Outputs of a stage.", "counter", |it| it.frames_out as f64),
        ("stage_restarts_total", "Replaced processes of a stage.", "counter", |it| {
            it.restarts as f64
        }),
        ("stage_cpu_seconds_total", "Processor time of a stage.", "counter", |it| it.cpu_seconds),
        ("stage_resident_bytes", "Memory of a stage's processes.", "gauge", |it| {
            it.rss_bytes as f64
        }),
    ];
    for (name, help, kind, value) in counters {
        text.begin(name, help, kind);
        for (stage, it) in &report.stages {
            text.value(name, &format!(",stage=\"{}\"", label(stage)), value(it));
        }
    }
    text.begin("attendant_restarts_total", "Restarts of a process that no stage needs.", "counter");
    for (name, it) in &report.attendants {
        text.value(
            "attendant_restarts_total",
            &format!(",process=\"{}\"", label(name)),
            it.restarts as f64,
        );
    }
    text.words
}

struct Text {
    words: String,
    instance: String,
}

impl Text {
    fn begin(&mut self, name: &str, help: &str, kind: &str) {
        let _ =
            writeln!(self.words, "# HELP touchline_{name} {help}\n# TYPE touchline_{name} {kind}");
    }

    fn value(&mut self, name: &str, labels: &str, value: f64) {
        let _ = writeln!(
            self.words,
            "touchline_{name}{{instance=\"{}\"{labels}}} {value}",
            self.instance
        );
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.begin(name, help, "counter");
        self.value(name, "", value as f64);
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.begin(name, help, "gauge");
        self.value(name, "", value);
    }

    fn quantiles(&mut self, name: &str, stage: &str, it: &Percentiles) {
        for (quantile, value) in [("0.5", it.p50), ("0.9", it.p90), ("0.99", it.p99), ("1", it.max)]
        {
            self.value(name, &format!(",stage=\"{stage}\",quantile=\"{quantile}\""), value);
        }
    }
}

/// A text as the value of a label.
fn label(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_a_comment_or_a_value() {
        let mut report = Report { instance: "a\"b".into(), ..Report::default() };
        report.stages.insert("tracker".into(), Default::default());
        let text = of(&report);
        assert!(
            text.contains(
                "touchline_stage_restarts_total{instance=\"a\\\"b\",stage=\"tracker\"} 0"
            )
        );
        for line in text.lines() {
            let is_value = || {
                let (name, value) = line.rsplit_once(' ').unwrap();
                name.ends_with('}') && value.parse::<f64>().is_ok()
            };
            assert!(line.starts_with("# ") || is_value(), "{line}");
        }
    }
}
