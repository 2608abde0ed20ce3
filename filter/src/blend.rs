//! Several hypotheses about how something moves, each with a Kalman filter of its own, weighed by
//! how well they explain what is seen.
//!
//! No single noise setting suits a robot that stands for a second, accelerates, and is hit by
//! another one: what smooths the first lags behind the third. So the motion model of the paper is
//! kept once per hypothesis, and the interacting-multiple-model scheme (Blom and Bar-Shalom, 1988)
//! blends them: before each prediction the filters exchange what they know in proportion to the odds
//! that the motion changes ([`Blend::mix`]); after each measurement the odds follow the likelihoods
//! ([`Blend::weigh`]); what goes out is the mean over all of them ([`Blend::merged`]).

use crate::gaussian::{Gaussian, Innovation};
use nalgebra::SVector;

/// Puts the angles of a state, or of a difference of states, back into (−π, π].
pub type Wrap<const N: usize> = fn(&mut SVector<f64, N>);

/// One hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis<const N: usize> {
    /// How likely it is.
    pub probability: f64,
    /// What is believed if it holds.
    pub belief: Gaussian<N>,
}

/// `M` hypotheses about a state of `N` components; their probabilities add up to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blend<const N: usize, const M: usize> {
    /// The hypotheses.
    pub hypotheses: [Hypothesis<N>; M],
}

impl<const N: usize, const M: usize> Blend<N, M> {
    /// The same belief under every hypothesis.
    pub fn new(belief: Gaussian<N>, probabilities: [f64; M]) -> Self {
        Self { hypotheses: probabilities.map(|probability| Hypothesis { probability, belief }) }
    }

    /// Lets a frame pass in which the motion may change: `odds[i][j]` is the probability that
    /// hypothesis `j` holds now if `i` did before. Each belief becomes the mean of all those from
    /// which its hypothesis may have arisen. Mean and covariance of the whole stay as they are.
    pub fn mix(&mut self, odds: &[[f64; M]; M], wrap: Wrap<N>) {
        let before = self.hypotheses;
        for (to, hypothesis) in self.hypotheses.iter_mut().enumerate() {
            let share = |from: usize| odds[from][to] * before[from].probability;
            let total: f64 = (0..M).map(share).sum();
            hypothesis.probability = total;
            if total > 0.0 {
                let weighted = (0..M).map(|from| (share(from) / total, &before[from].belief));
                hypothesis.belief = moments(weighted, &before[to].belief, wrap);
            }
        }
    }

    /// Multiplies the odds by the likelihoods of a measurement, given as logarithms (`None`:
    /// impossible under this hypothesis). Leaves them alone if it is impossible under all.
    pub fn weigh(&mut self, ln_likelihoods: &[Option<f64>; M]) {
        let best = ln_likelihoods.iter().flatten().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        let weight = |hypothesis: &Hypothesis<N>, ln_likelihood: &Option<f64>| {
            hypothesis.probability * ln_likelihood.map_or(0.0, |value| (value - best).exp())
        };
        let total: f64 =
            self.hypotheses.iter().zip(ln_likelihoods).map(|(h, l)| weight(h, l)).sum();
        if total.is_finite() && total > 0.0 {
            for (hypothesis, ln_likelihood) in self.hypotheses.iter_mut().zip(ln_likelihoods) {
                hypothesis.probability = weight(hypothesis, ln_likelihood) / total;
            }
        }
    }

    /// The probability density of a measurement, given its innovation under each hypothesis (`None`:
    /// impossible); `None` if it lies outside the gate of all.
    pub fn density<const Z: usize>(
        &self,
        innovations: &[Option<Innovation<Z>>; M],
        gate_chi2: f64,
    ) -> Option<f64> {
        let is_inside = innovations.iter().flatten().any(|i| i.distance2 <= gate_chi2);
        let density = |(i, h): (&Option<Innovation<Z>>, &Hypothesis<N>)| {
            i.map_or(0.0, |i| i.ln_density.exp() * h.probability)
        };
        is_inside.then(|| innovations.iter().zip(&self.hypotheses).map(density).sum())
    }

    /// Mean and covariance of the whole.
    pub fn merged(&self, wrap: Wrap<N>) -> Gaussian<N> {
        let weighted = self.hypotheses.iter().map(|h| (h.probability, &h.belief));
        moments(weighted, &self.most_likely().belief, wrap)
    }

    /// The mean alone.
    pub fn merged_mean(&self, wrap: Wrap<N>) -> SVector<f64, N> {
        let weighted = self.hypotheses.iter().map(|h| (h.probability, &h.belief));
        mean(weighted, &self.most_likely().belief.mean, wrap)
    }

    /// The hypothesis with the highest probability.
    pub fn most_likely(&self) -> &Hypothesis<N> {
        let first = &self.hypotheses[0];
        self.hypotheses.iter().fold(first, |best, hypothesis| {
            if hypothesis.probability > best.probability { hypothesis } else { best }
        })
    }

    /// Whether this can be the state of a track; see [`Gaussian::is_possible`].
    pub fn is_possible(&self, limits: &SVector<f64, N>) -> bool {
        let total: f64 = self.hypotheses.iter().map(|hypothesis| hypothesis.probability).sum();
        (total - 1.0).abs() < 1e-6
            && self.hypotheses.iter().all(|hypothesis| {
                (0.0..=1.0 + 1e-6).contains(&hypothesis.probability)
                    && hypothesis.belief.is_possible(limits)
            })
    }
}

/// Mean and covariance of a weighted mixture. Angles are averaged as differences from those of
/// `near`.
fn moments<'a, const N: usize>(
    weighted: impl Iterator<Item = (f64, &'a Gaussian<N>)> + Clone,
    near: &Gaussian<N>,
    wrap: Wrap<N>,
) -> Gaussian<N> {
    let mean = mean(weighted.clone(), &near.mean, wrap);
    let mut result = Gaussian { mean, covariance: nalgebra::SMatrix::zeros() };
    for (weight, belief) in weighted {
        let spread = difference(&belief.mean, &mean, wrap);
        for column in 0..N {
            for row in 0..=column {
                let outer = spread[row] * spread[column];
                result.covariance[(row, column)] +=
                    (belief.covariance[(row, column)] + outer) * weight;
            }
        }
    }
    result.symmetrise();
    result
}

/// Mean of a weighted mixture, likewise.
fn mean<'a, const N: usize>(
    weighted: impl Iterator<Item = (f64, &'a Gaussian<N>)>,
    near: &SVector<f64, N>,
    wrap: Wrap<N>,
) -> SVector<f64, N> {
    let mut mean = *near;
    for (weight, belief) in weighted {
        mean += difference(&belief.mean, near, wrap) * weight;
    }
    wrap(&mut mean);
    mean
}

fn difference<const N: usize>(
    to: &SVector<f64, N>,
    from: &SVector<f64, N>,
    wrap: Wrap<N>,
) -> SVector<f64, N> {
    let mut difference = to - from;
    wrap(&mut difference);
    difference
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, Vector1, Vector2};

    fn no_angles<const N: usize>(_: &mut SVector<f64, N>) {}

    fn two(probabilities: [f64; 2], means: [f64; 2]) -> Blend<1, 2> {
        let belief = Gaussian { mean: Vector1::new(0.0), covariance: Matrix1::new(1.0) };
        let mut blend = Blend::new(belief, probabilities);
        for (hypothesis, mean) in blend.hypotheses.iter_mut().zip(means) {
            hypothesis.belief.mean[0] = mean;
        }
        blend
    }

    #[test]
    fn the_whole_has_the_moments_of_a_mixture() {
        let merged = two([0.25, 0.75], [0.0, 4.0]).merged(no_angles);
        assert!((merged.mean[0] - 3.0).abs() < 1e-12);
        // Within each 1, between them 0.25 · 0.75 · 4².
        assert!((merged.covariance[0] - 4.0).abs() < 1e-12);
    }

    #[test]
    fn mixing_keeps_the_whole() {
        let mut blend = two([0.25, 0.75], [0.0, 4.0]);
        let before = blend.merged(no_angles);
        blend.mix(&[[0.9, 0.1], [0.3, 0.7]], no_angles);
        let after = blend.merged(no_angles);
        assert!((before.mean - after.mean).norm() < 1e-12);
        assert!((before.covariance - after.covariance).norm() < 1e-12);
        // 0.25 · 0.9 + 0.75 · 0.3, of which the second half comes from 4.
        assert!((blend.hypotheses[0].probability - 0.45).abs() < 1e-12);
        assert!((blend.hypotheses[0].belief.mean[0] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn odds_follow_the_likelihoods() {
        let mut blend = two([0.5, 0.5], [0.0, 4.0]);
        blend.weigh(&[Some(-1000.0), Some(-1000.0 + 3.0f64.ln())]);
        assert!((blend.hypotheses[1].probability - 0.75).abs() < 1e-12);
        blend.weigh(&[None, None]);
        assert!((blend.hypotheses[1].probability - 0.75).abs() < 1e-12);
        blend.weigh(&[Some(0.0), None]);
        assert_eq!(blend.hypotheses[1].probability, 0.0);
    }

    #[test]
    fn angles_are_averaged_the_short_way_round() {
        fn wrap(state: &mut Vector2<f64>) {
            state[0] = common::geometry::wrap_angle(state[0]);
        }
        let belief =
            Gaussian { mean: Vector2::new(3.1, 0.0), covariance: Matrix2::identity() * 1e-4 };
        let mut blend = Blend::new(belief, [0.5, 0.5]);
        blend.hypotheses[1].belief.mean[0] = -3.1;
        let merged = blend.merged(wrap);
        assert!((merged.mean[0].abs() - std::f64::consts::PI).abs() < 1e-9, "{merged:?}");
        assert!(merged.covariance[(0, 0)] < 0.01);
    }
}
