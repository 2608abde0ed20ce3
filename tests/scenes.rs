//! `touchline score --synthetic`: every robot and the ball of every scene, under the right names.

mod support;

use serde_json::Value;
use support::{Scratch, output_of};

#[test]
fn everything_is_found_in_every_scene() {
    let scratch = Scratch::new("scenes");
    let output = output_of(&scratch, &["score", "--synthetic", "--frames", "8", "--json"]);
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{complaint}");
    let text = String::from_utf8(output.stdout).unwrap();
    let scenes: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for wanted in ["green-floor", "blue-floor", "white-and-grey", "fisheye", "ball-covered", "dim"]
    {
        assert!(scenes.iter().any(|scene| scene["scene"] == wanted), "{wanted}");
    }
    for scene in scenes {
        assert_eq!(scene["found_ratio"], 1.0, "{scene}");
        assert_eq!(scene["wrong_identity"], 0, "{scene}");
        assert_eq!(scene["ball_found_ratio"], 1.0, "{scene}");
        assert!(scene["position_rms_mm"].as_f64().unwrap() < 1.0, "{scene}");
        assert!(scene["heading_rms_deg"].as_f64().unwrap() < 1.5, "{scene}");
        assert!(scene["ball_rms_mm"].as_f64().unwrap() < 5.0, "{scene}");
    }
}
