//! The interacting-multiple-model estimator (Blom and Bar-Shalom, *The interacting multiple model algorithm
//! for systems with Markovian switching coefficients*, 1988).
//!
//! No single noise setting suits a robot that stands for a second, accelerates, and is hit by another one: a
//! setting that smooths the first lags behind the third. So the motion model of the paper is kept once per
//! hypothesis, each with its Kalman filter and its probability μ. With the transition probabilities p_ij
//! between hypotheses, a frame has three steps. Mixing ([`Imm::mix`]), before the prediction: μ_j = Σ_i p_ij
//! μ_i, and filter j restarts from the mean and covariance of the mixture of all filters i with weights p_ij
//! μ_i / μ_j. Reweighting ([`Imm::update_probabilities`]), after the measurement: μ_j is multiplied by the
//! likelihood of the measurement under j, and normalised. Output ([`Imm::merged`]): mean and covariance of
//! the mixture of all.

use crate::gaussian::{Gaussian, Innovation};
use nalgebra::SVector;

/// Wraps the angles of a state, or of a difference of states, into (−π, π].
pub type Wrap<const N: usize> = fn(&mut SVector<f64, N>);

/// One hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypothesis<const N: usize> {
    /// Its probability.
    pub probability: f64,
    /// The belief if it holds.
    pub belief: Gaussian<N>,
}

/// `M` hypotheses about a state of `N` components; their probabilities add up to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imm<const N: usize, const M: usize> {
    /// The hypotheses.
    pub hypotheses: [Hypothesis<N>; M],
}

impl<const N: usize, const M: usize> Imm<N, M> {
    /// The same belief under every hypothesis.
    pub fn new(belief: Gaussian<N>, probabilities: [f64; M]) -> Self {
        Self { hypotheses: probabilities.map(|probability| Hypothesis { probability, belief }) }
    }

    /// Mixing: `transitions[i][j]` is the probability that hypothesis `j` holds now if `i` did before. Each
    /// belief becomes the mean of all those from which its hypothesis may have arisen. Mean and covariance of
    /// the mixture do not change.
    pub fn mix(&mut self, transitions: &[[f64; M]; M], wrap: Wrap<N>) {
        let before = self.hypotheses;
        for (to, hypothesis) in self.hypotheses.iter_mut().enumerate() {
            let share = |from: usize| transitions[from][to] * before[from].probability;
            let total: f64 = (0..M).map(share).sum();
            hypothesis.probability = total;
            if total > 0.0 {
                let weighted = (0..M).map(|from| (share(from) / total, &before[from].belief));
                hypothesis.belief = moments(weighted, &before[to].belief, wrap);
            }
        }
    }

    /// Multiplies the probabilities by the likelihoods of a measurement, given as logarithms (`None`:
    /// impossible under this hypothesis). No effect if it is impossible under all.
    pub fn update_probabilities(&mut self, ln_likelihoods: &[Option<f64>; M]) {
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

    /// Probability density of a measurement, given its innovation under each hypothesis (`None`: impossible);
    /// `None` if it lies outside the gate of all.
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

    /// Mean and covariance of the mixture.
    pub fn merged(&self, wrap: Wrap<N>) -> Gaussian<N> {
        let weighted = self.hypotheses.iter().map(|h| (h.probability, &h.belief));
        moments(weighted, &self.most_likely().belief, wrap)
    }

    /// Mean of the mixture.
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

    /// Whether this is a valid state of a track; see [`Gaussian::is_possible`].
    pub fn is_possible(&self, limits: &SVector<f64, N>) -> bool {
        let total: f64 = self.hypotheses.iter().map(|hypothesis| hypothesis.probability).sum();
        (total - 1.0).abs() < 1e-6
            && self.hypotheses.iter().all(|hypothesis| {
                (0.0..=1.0 + 1e-6).contains(&hypothesis.probability)
                    && hypothesis.belief.is_possible(limits)
            })
    }
}

/// Mean and covariance of a weighted mixture. Angles are averaged as differences from those of `near`.
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

/// Mean of a weighted mixture. Angles are averaged as differences from those of `near`.
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

    fn wrap_nothing<const N: usize>(_: &mut SVector<f64, N>) {}

    fn two(probabilities: [f64; 2], means: [f64; 2]) -> Imm<1, 2> {
        let belief = Gaussian { mean: Vector1::new(0.0), covariance: Matrix1::new(1.0) };
        let mut imm = Imm::new(belief, probabilities);
        for (hypothesis, mean) in imm.hypotheses.iter_mut().zip(means) {
            hypothesis.belief.mean[0] = mean;
        }
        imm
    }

    #[test]
    fn merged_moments_are_those_of_the_mixture() {
        let merged = two([0.25, 0.75], [0.0, 4.0]).merged(wrap_nothing);
        assert!((merged.mean[0] - 3.0).abs() < 1e-12);
        // 1 within each hypothesis, 0.25 · 0.75 · 4² between them.
        assert!((merged.covariance[0] - 4.0).abs() < 1e-12);
    }

    #[test]
    fn mixing_preserves_the_mixture() {
        let mut imm = two([0.25, 0.75], [0.0, 4.0]);
        let before = imm.merged(wrap_nothing);
        imm.mix(&[[0.9, 0.1], [0.3, 0.7]], wrap_nothing);
        let after = imm.merged(wrap_nothing);
        assert!((before.mean - after.mean).norm() < 1e-12);
        assert!((before.covariance - after.covariance).norm() < 1e-12);
        // 0.25 · 0.9 + 0.75 · 0.3; half of it comes from 4.
        assert!((imm.hypotheses[0].probability - 0.45).abs() < 1e-12);
        assert!((imm.hypotheses[0].belief.mean[0] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn probabilities_follow_the_likelihoods() {
        let mut imm = two([0.5, 0.5], [0.0, 4.0]);
        imm.update_probabilities(&[Some(-1000.0), Some(-1000.0 + 3.0f64.ln())]);
        assert!((imm.hypotheses[1].probability - 0.75).abs() < 1e-12);
        imm.update_probabilities(&[None, None]);
        assert!((imm.hypotheses[1].probability - 0.75).abs() < 1e-12);
        imm.update_probabilities(&[Some(0.0), None]);
        assert_eq!(imm.hypotheses[1].probability, 0.0);
    }

    #[test]
    fn angles_are_averaged_the_short_way_round() {
        fn wrap(state: &mut Vector2<f64>) {
            state[0] = geometry::wrap_angle(state[0]);
        }
        let belief =
            Gaussian { mean: Vector2::new(3.1, 0.0), covariance: Matrix2::identity() * 1e-4 };
        let mut imm = Imm::new(belief, [0.5, 0.5]);
        imm.hypotheses[1].belief.mean[0] = -3.1;
        let merged = imm.merged(wrap);
        assert!((merged.mean[0].abs() - std::f64::consts::PI).abs() < 1e-9, "{merged:?}");
        assert!(merged.covariance[(0, 0)] < 0.01);
    }
}
