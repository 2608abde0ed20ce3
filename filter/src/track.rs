//! The life of a track, the same for robots and the ball: first sight, measurements, outliers, gaps, jumps,
//! and removal.
//!
//! The paper asks for two things beside the filter equations: outliers are ignored, and after a collision the
//! filter is initialised with the current measurement. Both are decided by the innovation's squared
//! Mahalanobis distance d² = (z − ẑ)ᵀ S⁻¹ (z − ẑ). A measurement with d² ≤ `filter.gate_chi2` under some
//! hypothesis corrects the track; one outside is ignored, until `filter.reinit_after` of them in a row agree
//! with one another, which starts the track over.

use crate::gaussian::Innovation;
use crate::imm::{Imm, Wrap};
use config::FilterConfig;
use messages::TrackStatus;
use nalgebra::{SMatrix, SVector};

/// Motion model of a tracked object: `N` components of state, of which the first `Z` are measured, and `M`
/// hypotheses.
pub trait Motion<const N: usize, const M: usize, const Z: usize> {
    /// Wraps the angles of a state.
    const WRAP: Wrap<N>;
    /// Wraps the angles of a measurement.
    const WRAP_MEASURED: Wrap<Z>;
    /// Probabilities of transitions between hypotheses from one frame to the next.
    const TRANSITIONS: [[f64; M]; M];

    /// Covariance of a measurement that does not state its own: the configured R.
    fn noise(&self) -> &SMatrix<f64, Z, Z>;
    /// State after a single measurement: x̂(0), P(0).
    fn initial(&self, measured: &SVector<f64, Z>) -> Imm<N, M>;
    /// Limit on the change of each measured component in a time, noise included.
    fn reach(&self, dt_s: f64) -> SVector<f64, Z>;
    /// Limits of the magnitudes of a valid state.
    fn limits(&self) -> SVector<f64, N>;
}

/// A detection that may belong to a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate<const Z: usize> {
    /// The measurement; finite.
    pub measured: SVector<f64, Z>,
    /// Its covariance, R; positive definite.
    pub noise: SMatrix<f64, Z, Z>,
    /// 0–1.
    pub confidence: f64,
}

/// One innovation per hypothesis; `None` if its covariance is unusable.
type Innovations<const Z: usize, const M: usize> = [Option<Innovation<Z>>; M];

/// The newest measurement outside the gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Suspect<const Z: usize> {
    /// Its capture time.
    pub t_ns: u64,
    /// The measurement.
    pub measured: SVector<f64, Z>,
    /// Number of consecutive such measurements that agree with one another, this one included; 0 if there is
    /// none.
    pub agreeing: u32,
}

/// Rules for the life of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackRules {
    /// `filter.gate_chi2`
    pub gate_chi2: f64,
    /// `filter.reinit_after`
    pub reinit_after: u32,
    /// `filter.forget_after_ms`
    pub forget_after_s: f64,
    /// `filter.start_confidence`
    pub start_confidence: f64,
}

impl TrackRules {
    /// From the configuration.
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            gate_chi2: config.gate_chi2,
            reinit_after: config.reinit_after.max(1),
            forget_after_s: config.forget_after_ms * 1e-3,
            start_confidence: config.start_confidence,
        }
    }
}

/// A tracked object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Track<const N: usize, const M: usize, const Z: usize> {
    /// Estimated position and motion.
    pub imm: Imm<N, M>,
    /// Origin of the state in the newest frame.
    pub status: TrackStatus,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames in a row whose measurement lay outside the gate.
    pub frames_gated: u32,
    /// Capture time of the newest usable measurement.
    pub t_seen_ns: u64,
    /// Candidate for re-initialisation.
    pub suspect: Suspect<Z>,
}

/// Limit of the time between two measurements outside the gate that may agree with each other.
const MAX_SUSPECT_AGE_S: f64 = 0.1;

/// Limit of unseen frames after which a candidate of low confidence may still continue a track.
const MAX_DOUBTFUL_GAP_FRAMES: u32 = 2;

impl<const N: usize, const M: usize, const Z: usize> Track<N, M, Z> {
    /// A new track at a measurement.
    pub fn start(measured: &SVector<f64, Z>, t_ns: u64, motion: &impl Motion<N, M, Z>) -> Self {
        Self {
            imm: motion.initial(measured),
            status: TrackStatus::Initialised,
            frames_unseen: 0,
            frames_gated: 0,
            t_seen_ns: t_ns,
            suspect: Suspect { t_ns: 0, measured: SVector::zeros(), agreeing: 0 },
        }
    }

    /// Corrects the predicted track by the candidates of the frame captured at `t_ns`, and sets its status.
    /// `repeats` gives, for each hypothesis, the number of consecutive measurements that share one error (1:
    /// independent), by which R is multiplied.
    ///
    /// * the likeliest candidate within the gate corrects the track (`Measured`);
    /// * failing that, a confident one outside the gate is an outlier and ignored (`Gated`), unless
    ///   it agrees with enough such before it: then the track starts over from it (`Initialised`);
    /// * failing that, the track coasts (`Coasting`).
    pub fn observe<T: Motion<N, M, Z>, I>(
        &mut self,
        candidates: I,
        repeats: &[f64; M],
        t_ns: u64,
        motion: &T,
        rules: &TrackRules,
    ) where
        I: Iterator<Item = Candidate<Z>> + Clone,
    {
        if let Some((best, innovations)) = self.likeliest::<T>(candidates.clone(), rules) {
            self.correct::<T>(&best, &innovations, repeats);
            self.status = TrackStatus::Measured;
            self.frames_unseen = 0;
            self.frames_gated = 0;
            self.t_seen_ns = t_ns;
            self.suspect.agreeing = 0;
            return;
        }
        self.frames_unseen = self.frames_unseen.saturating_add(1);
        let confident = candidates.filter(|c| c.confidence >= rules.start_confidence);
        match self.suspect_after(confident, t_ns, motion) {
            Some(suspect) if suspect.agreeing >= rules.reinit_after => {
                *self = Self::start(&suspect.measured, t_ns, motion);
            }
            Some(suspect) => {
                self.suspect = suspect;
                self.status = TrackStatus::Gated;
                self.frames_gated = self.frames_gated.saturating_add(1);
            }
            None => {
                self.status = TrackStatus::Coasting;
                self.frames_gated = 0;
            }
        }
    }

    /// 1 when seen in the frame captured at `t_ns`, falling linearly to 0 when the track is forgotten.
    pub fn visibility(&self, t_ns: u64, rules: &TrackRules) -> f32 {
        (1.0 - self.unseen_s(t_ns) / rules.forget_after_s).clamp(0.0, 1.0) as f32
    }

    /// Whether the track has been unseen for too long.
    pub fn is_forgotten(&self, t_ns: u64, rules: &TrackRules) -> bool {
        self.unseen_s(t_ns) > rules.forget_after_s
    }

    fn unseen_s(&self, t_ns: u64) -> f64 {
        t_ns.saturating_sub(self.t_seen_ns) as f64 * 1e-9
    }

    /// Probability density of a measurement under the track, per unit of each component; `None` outside the
    /// gate of every hypothesis.
    pub fn density<T: Motion<N, M, Z>>(
        &self,
        candidate: &Candidate<Z>,
        rules: &TrackRules,
    ) -> Option<f64> {
        self.imm.density(&self.innovations::<T>(candidate), rules.gate_chi2)
    }

    /// The candidate with the greatest product of confidence and likelihood among those within the gate of at
    /// least one hypothesis, and its innovations. A candidate of too low confidence to start a track may
    /// continue it, but not recover it: the track must have been seen within the last frames, and the gate of
    /// the struck hypothesis does not count.
    fn likeliest<T: Motion<N, M, Z>>(
        &self,
        candidates: impl Iterator<Item = Candidate<Z>>,
        rules: &TrackRules,
    ) -> Option<(Candidate<Z>, Innovations<Z, M>)> {
        let mut best: Option<(Candidate<Z>, Innovations<Z, M>)> = None;
        let score = |(candidate, innovations): &(Candidate<Z>, Innovations<Z, M>)| {
            let density: f64 = innovations
                .iter()
                .zip(&self.imm.hypotheses)
                .filter_map(|(i, h)| i.map(|i| i.ln_density.exp() * h.probability))
                .sum();
            candidate.confidence * density
        };
        for candidate in candidates.filter(|candidate| candidate.confidence > 0.0) {
            let innovations = self.innovations::<T>(&candidate);
            let believable = if candidate.confidence >= rules.start_confidence {
                M
            } else if self.frames_unseen <= MAX_DOUBTFUL_GAP_FRAMES {
                M.saturating_sub(1)
            } else {
                0
            };
            let inside = innovations[..believable]
                .iter()
                .flatten()
                .any(|innovation| innovation.distance2 <= rules.gate_chi2);
            let this = (candidate, innovations);
            // Mostly there is just one.
            if inside && best.as_ref().is_none_or(|best| score(&this) > score(best)) {
                best = Some(this);
            }
        }
        best
    }

    fn correct<T: Motion<N, M, Z>>(
        &mut self,
        candidate: &Candidate<Z>,
        innovations: &Innovations<Z, M>,
        repeats: &[f64; M],
    ) {
        self.imm.update_probabilities(&std::array::from_fn(|index| {
            innovations[index].map(|i| i.ln_density)
        }));
        for ((hypothesis, innovation), &repeats) in
            self.imm.hypotheses.iter_mut().zip(innovations).zip(repeats)
        {
            let noise = candidate.noise * repeats;
            let shared = match innovation {
                Some(i) if repeats != 1.0 => hypothesis.belief.innovation(i.difference, &noise),
                plain => *plain,
            };
            if let Some(innovation) = shared {
                hypothesis.belief.correct(&innovation, &noise);
                T::WRAP(&mut hypothesis.belief.mean);
            }
        }
    }

    fn innovations<T: Motion<N, M, Z>>(&self, candidate: &Candidate<Z>) -> Innovations<Z, M> {
        std::array::from_fn(|index| {
            let belief = &self.imm.hypotheses[index].belief;
            let mut difference = candidate.measured - belief.mean.fixed_rows::<Z>(0);
            T::WRAP_MEASURED(&mut difference);
            belief.innovation(difference, &candidate.noise)
        })
    }

    /// The candidate for re-initialisation after this frame: one that agrees with the previous one, or else
    /// the most confident. `None` without candidates.
    fn suspect_after<T: Motion<N, M, Z>>(
        &self,
        candidates: impl Iterator<Item = Candidate<Z>>,
        t_ns: u64,
        motion: &T,
    ) -> Option<Suspect<Z>> {
        let before = &self.suspect;
        let dt_s = t_ns.saturating_sub(before.t_ns) as f64 * 1e-9;
        let reach = motion.reach(dt_s);
        let agrees = |candidate: &Candidate<Z>| {
            let mut difference = candidate.measured - before.measured;
            T::WRAP_MEASURED(&mut difference);
            before.agreeing > 0
                && dt_s <= MAX_SUSPECT_AGE_S
                && difference.iter().zip(reach.iter()).all(|(moved, reach)| moved.abs() <= *reach)
        };
        let best = candidates
            .max_by(|a, b| agrees(a).cmp(&agrees(b)).then(a.confidence.total_cmp(&b.confidence)))?;
        let agreeing = if agrees(&best) { before.agreeing.saturating_add(1) } else { 1 };
        Some(Suspect { t_ns, measured: best.measured, agreeing })
    }
}
