//! The life of a track, the same for robots and the ball: from first sight, through measurements,
//! outliers, gaps and jumps, until it is forgotten.

use crate::blend::{Blend, Wrap};
use crate::gaussian::Innovation;
use common::config::FilterConfig;
use common::messages::TrackStatus;
use nalgebra::{SMatrix, SVector};

/// What a track needs to know about the thing it follows: `N` components of state, the first `Z` of
/// them measured, `M` hypotheses about its motion.
pub trait Motion<const N: usize, const M: usize, const Z: usize> {
    /// Wraps the angles of a state.
    const WRAP: Wrap<N>;
    /// Wraps the angles of a measurement.
    const WRAP_MEASURED: Wrap<Z>;
    /// Odds that one hypothesis takes over from another between two frames.
    const ODDS: [[f64; M]; M];

    /// Covariance of a measurement that does not say how uncertain it is: the configured R.
    fn noise(&self) -> &SMatrix<f64, Z, Z>;
    /// The state before anything but one measurement is known: x̂(0), P(0).
    fn initial(&self, measured: &SVector<f64, Z>) -> Blend<N, M>;
    /// How far each measured component may move in a time, noise included.
    fn reach(&self, dt_s: f64) -> SVector<f64, Z>;
    /// Magnitudes beyond which a state is rubbish.
    fn limits(&self) -> SVector<f64, N>;
}

/// One thing seen in this frame that might be the one a track follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate<const Z: usize> {
    /// What was measured; finite.
    pub measured: SVector<f64, Z>,
    /// Its covariance, R; positive definite.
    pub noise: SMatrix<f64, Z, Z>,
    /// 0–1.
    pub confidence: f64,
}

/// Those of a candidate under each hypothesis; `None` where its noise is of no use.
type Innovations<const Z: usize, const M: usize> = [Option<Innovation<Z>>; M];

/// The newest measurement outside the gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Suspect<const Z: usize> {
    /// When it was seen.
    pub t_ns: u64,
    /// What was measured.
    pub measured: SVector<f64, Z>,
    /// How many, up to this one, agree with one another; 0 when there is none.
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
    /// As configured.
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            gate_chi2: config.gate_chi2,
            reinit_after: config.reinit_after.max(1),
            forget_after_s: config.forget_after_ms * 1e-3,
            start_confidence: config.start_confidence,
        }
    }
}

/// One thing that is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Track<const N: usize, const M: usize, const Z: usize> {
    /// Where it is believed to be and how it moves.
    pub blend: Blend<N, M>,
    /// How it came by its state in the newest frame.
    pub status: TrackStatus,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames in a row whose measurement lay outside the gate.
    pub frames_gated: u32,
    /// Capture time of the newest usable measurement.
    pub t_seen_ns: u64,
    /// What may turn out to be where it has gone.
    pub suspect: Suspect<Z>,
}

/// Two measurements outside the gate that are further apart in time have nothing to do with each
/// other.
const MAX_SUSPECT_AGE_S: f64 = 0.1;

/// A doubtful candidate may continue a track that has been unseen for at most so many frames.
const MAX_DOUBTFUL_GAP_FRAMES: u32 = 2;

impl<const N: usize, const M: usize, const Z: usize> Track<N, M, Z> {
    /// A track that begins at a measurement.
    pub fn start(measured: &SVector<f64, Z>, t_ns: u64, motion: &impl Motion<N, M, Z>) -> Self {
        Self {
            blend: motion.initial(measured),
            status: TrackStatus::Initialised,
            frames_unseen: 0,
            frames_gated: 0,
            t_seen_ns: t_ns,
            suspect: Suspect { t_ns: 0, measured: SVector::zeros(), agreeing: 0 },
        }
    }

    /// Corrects the prediction (already made) by what was seen in the frame captured at `t_ns`, and
    /// decides what that was. `repeats` says, by hypothesis, how many measurements in a row have
    /// the same error (1: each has its own), and so how little a single one is worth.
    ///
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

    /// 1 when seen in the frame captured at `t_ns`, falling evenly to 0 when the track is forgotten.
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

    /// The probability density of a measurement under what is believed of the track, per unit of each
    /// component; `None` outside the gate of every hypothesis.
    pub fn density<T: Motion<N, M, Z>>(
        &self,
        candidate: &Candidate<Z>,
        rules: &TrackRules,
    ) -> Option<f64> {
        self.blend.density(&self.innovations::<T>(candidate), rules.gate_chi2)
    }

    /// The candidate with the greatest product of confidence and likelihood among those within the
    /// gate of at least one hypothesis, and its innovations. A doubtful one, that could not start a track, is good
    /// enough to go on with but not to find something again: it must be where the track, seen a
    /// moment ago, leads without being struck.
    fn likeliest<T: Motion<N, M, Z>>(
        &self,
        candidates: impl Iterator<Item = Candidate<Z>>,
        rules: &TrackRules,
    ) -> Option<(Candidate<Z>, Innovations<Z, M>)> {
        let mut best: Option<(Candidate<Z>, Innovations<Z, M>)> = None;
        let score = |(candidate, innovations): &(Candidate<Z>, Innovations<Z, M>)| {
            let density: f64 = innovations
                .iter()
                .zip(&self.blend.hypotheses)
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
        self.blend.weigh(&std::array::from_fn(|index| innovations[index].map(|i| i.ln_density)));
        for ((hypothesis, innovation), &repeats) in
            self.blend.hypotheses.iter_mut().zip(innovations).zip(repeats)
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
            let belief = &self.blend.hypotheses[index].belief;
            let mut difference = candidate.measured - belief.mean.fixed_rows::<Z>(0);
            T::WRAP_MEASURED(&mut difference);
            belief.innovation(difference, &candidate.noise)
        })
    }

    /// The suspect after this frame: a candidate that agrees with the one before, or else the most
    /// confident. `None` without candidates.
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
