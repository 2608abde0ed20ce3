//! Slip: the difference between a robot's motion and that of its wheels.
//!
//! It follows the filter's model, with the filter's own numbers: white noises of speed, turning rate and
//! sideways motion ([`FilterConfig::NOISE_LASTS_S`]). So the filter's covariances can be tested with a match
//! in which its model is true.

use super::motion::{Twist, WheelSpeeds, drive};
use super::random::Random;
use config::{Config, FilterConfig};
use geometry::{FieldPoint, Pose};

/// A robot's slip during one frame, for fast wheels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Slip {
    /// Added to its motion.
    twist: Twist,
    /// Added to its motion to the left.
    sideways_mm_s: f64,
}

/// Strength of slip, 1σ, if it is constant during a frame.
#[derive(Debug, Clone)]
pub struct SlipRate {
    sigma: Slip,
    random: Random,
}

impl SlipRate {
    /// From the configuration.
    pub fn new(config: &Config, random: Random) -> Self {
        let filter = &config.filter;
        // Slip that is constant during a frame displaces a robot as far as white noise does.
        let scale =
            config.synthetic.slip * (FilterConfig::NOISE_LASTS_S * config.camera.fps).sqrt();
        let twist = Twist {
            v_mm_s: scale * filter.command_noise_mm_s,
            omega: scale * filter.command_noise_deg_s.to_radians(),
        };
        Self { sigma: Slip { twist, sideways_mm_s: scale * filter.lateral_noise_mm_s }, random }
    }

    /// A robot's slip for one frame.
    pub fn draw(&mut self) -> Slip {
        let Self { sigma: Slip { twist, sideways_mm_s }, random } = self;
        Slip {
            twist: Twist {
                v_mm_s: twist.v_mm_s * random.normal(),
                omega: twist.omega * random.normal(),
            },
            sideways_mm_s: *sideways_mm_s * random.normal(),
        }
    }
}

impl Slip {
    /// The pose after `dt_s` of a robot whose wheels turn with `speeds`, which would give it `twist`.
    pub fn drive(&self, pose: Pose, speeds: WheelSpeeds, twist: Twist, dt_s: f64) -> Pose {
        let wheel_mm_s = speeds.left_mm_s.abs().max(speeds.right_mm_s.abs());
        let share = (wheel_mm_s / FilterConfig::FULL_SLIP_MM_S).min(1.0);
        let twist = Twist {
            v_mm_s: twist.v_mm_s + share * self.twist.v_mm_s,
            omega: twist.omega + share * self.twist.omega,
        };
        let driven = drive(pose, twist, dt_s);
        let slide_mm = share * self.sideways_mm_s * dt_s;
        if slide_mm == 0.0 {
            return driven;
        }
        let (sin, cos) = driven.orientation.sin_cos();
        let FieldPoint { x_mm, y_mm } = driven.position;
        let position = FieldPoint::new(x_mm - slide_mm * sin, y_mm + slide_mm * cos);
        Pose { position, ..driven }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At any frame rate, a second's slip has the variance that the filter assumes.
    #[test]
    fn slip_adds_up_to_the_noise_of_the_filter() {
        for fps in [20.0, 80.0, 160.0] {
            let mut config = Config::default();
            config.camera.fps = fps;
            config.synthetic.slip = 1.0;
            let mut rate = SlipRate::new(&config, Random::new(3, 1));
            let wheels = WheelSpeeds { left_mm_s: 300.0, right_mm_s: 300.0 };
            let twist = wheels.twist(60.0);
            let seconds = 600;
            let mut squares = [0.0; 3];
            for _ in 0..seconds {
                let mut strayed = [0.0; 3];
                for _ in 0..fps as u32 {
                    let Pose { position, orientation } =
                        rate.draw().drive(Pose::default(), wheels, twist, 1.0 / fps);
                    strayed[0] += position.x_mm - 300.0 / fps;
                    strayed[1] += position.y_mm;
                    strayed[2] += orientation.to_degrees();
                }
                squares.iter_mut().zip(strayed).for_each(|(sum, off)| *sum += off * off);
            }
            let filter = &config.filter;
            // The sideways motion, and half of the slip's rotation, which is little.
            let sigmas =
                [filter.command_noise_mm_s, filter.lateral_noise_mm_s, filter.command_noise_deg_s];
            for (axis, (sum, sigma)) in squares.iter().zip(sigmas).enumerate() {
                let expected = sigma * sigma * FilterConfig::NOISE_LASTS_S;
                let ratio = sum / f64::from(seconds) / expected;
                assert!((0.8..1.25).contains(&ratio), "{fps} fps, axis {axis}: {ratio}");
            }
        }
    }

    #[test]
    fn wheels_that_stand_do_not_slip() {
        let mut config = Config::default();
        config.synthetic.slip = 1.0;
        let pose = Pose { position: FieldPoint::new(10.0, -20.0), orientation: 0.5 };
        let slip = SlipRate::new(&config, Random::new(3, 1)).draw();
        let moved = slip.drive(pose, WheelSpeeds::default(), Twist::default(), 0.0125);
        assert_eq!(moved, pose);
    }
}
