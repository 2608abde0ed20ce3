//! Choice of the instruction set: the best one that the machine has, or the requested one, if it passes a
//! test.

use super::lanes::Lanes;
use super::self_test;
use super::{Scratch, Setup, bayer, color};
use super::{Written, scalar};
use crate::picture::Picture;
use fearless_simd::Level;
use messages::Run;
use std::fmt;
use std::sync::OnceLock;

/// Instruction sets with a kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SimdLevel {
    /// 64 bytes at a time: AVX-512 as of Ice Lake and Zen 4, with VBMI.
    Avx512,
    /// 32 bytes at a time: AVX2, x86 since 2013.
    Avx2,
    /// 16 bytes at a time: SSE4.2, x86 since 2008.
    Sse42,
    /// 16 bytes at a time: every 64-bit ARM.
    Neon,
    /// One pixel after the other, on any machine: the specification.
    Scalar,
}

impl SimdLevel {
    /// All levels, fastest first.
    pub const ALL: [SimdLevel; 5] =
        [Self::Avx512, Self::Avx2, Self::Sse42, Self::Neon, Self::Scalar];

    /// Its name in `TOUCHLINE_SIMD`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Sse42 => "sse4.2",
            Self::Neon => "neon",
            Self::Scalar => "scalar",
        }
    }

    /// The level with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|level| level.name() == name)
    }

    /// The levels that this machine has and that pass their test, fastest first; the last one is always
    /// [`Scalar`](Self::Scalar).
    pub fn available() -> Vec<Self> {
        Self::ALL
            .into_iter()
            .filter(|level| level.is_present() && level.passes_self_test())
            .collect()
    }

    /// Whether this machine has the instructions.
    pub fn is_present(self) -> bool {
        let machine = Level::new();
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => machine.as_avx512().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => machine.as_avx2().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Sse42 => machine.as_sse4_2().is_some(),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => machine.as_neon().is_some(),
            #[allow(unreachable_patterns)] // depends on the architecture
            _ => {
                let _ = machine;
                false
            }
        }
    }

    /// Whether the level agrees with the scalar code on this machine, on small test pictures. Tested once in
    /// a process, in well below a millisecond: an error in a compiler, a library, an emulator or this crate
    /// cannot go unnoticed into a match.
    pub fn passes_self_test(self) -> bool {
        static VERDICTS: [OnceLock<bool>; SimdLevel::ALL.len()] =
            [const { OnceLock::new() }; SimdLevel::ALL.len()];
        *VERDICTS[self as usize].get_or_init(|| self_test::passes(self))
    }

    /// Runs the code of the level.
    pub(super) fn classify(
        self,
        picture: &Picture,
        setup: Setup,
        scratch: &mut Scratch,
        out: &mut [Run],
    ) -> Written {
        let machine = Level::new();
        /// Returns the result of a level if its token is there, which it always is for a present level.
        macro_rules! run_if_present {
            ($token:expr) => {
                if let Some(simd) = $token {
                    return run(simd, picture, setup, scratch, out);
                }
            };
        }
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => run_if_present!(machine.as_avx512()),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => run_if_present!(machine.as_avx2()),
            #[cfg(target_arch = "x86_64")]
            Self::Sse42 => run_if_present!(machine.as_sse4_2()),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => run_if_present!(machine.as_neon()),
            _ => {}
        }
        scalar::classify(picture, setup.zoned, setup.mask, out)
    }
}

/// Compiles the kernels for an instruction set.
fn run<S: Lanes>(
    simd: S,
    picture: &Picture,
    setup: Setup,
    scratch: &mut Scratch,
    out: &mut [Run],
) -> Written {
    simd.vectorize(
        #[inline(always)]
        || match picture {
            Picture::Bayer(image) => bayer::classify(simd, image, setup, &mut scratch.bayer, out),
            Picture::Color(image) => color::classify(simd, image, setup, &mut scratch.color, out),
        },
    )
}

impl fmt::Display for SimdLevel {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// The level that classifiers of this process use, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SimdChoice {
    /// The level in use.
    pub level: SimdLevel,
    /// Why it is not the requested one, or not the machine's best.
    pub complaint: Option<String>,
}

/// Environment variable that selects a level instead of the fastest one.
const VARIABLE: &str = "TOUCHLINE_SIMD";

impl SimdChoice {
    /// The fastest level that works on this machine, or the one selected by the environment variable
    /// `TOUCHLINE_SIMD`. Decided once; later changes of the variable have no effect.
    pub fn of_process() -> &'static Self {
        static CHOICE: OnceLock<SimdChoice> = OnceLock::new();
        CHOICE.get_or_init(|| {
            let asked = std::env::var_os(VARIABLE).map(|name| name.to_string_lossy().into_owned());
            Self::new(asked.as_deref(), SimdLevel::is_present, SimdLevel::passes_self_test)
        })
    }

    fn new(
        asked: Option<&str>,
        is_present: impl Fn(SimdLevel) -> bool,
        passes_self_test: impl Fn(SimdLevel) -> bool,
    ) -> Self {
        let mut complaints = Vec::new();
        let wanted = asked.filter(|name| !name.is_empty()).and_then(|name| {
            let level = SimdLevel::from_name(name);
            match level {
                None => complaints.push(format!(
                    "{VARIABLE}={name} is unknown, it can be {}",
                    SimdLevel::ALL.map(SimdLevel::name).join(", ")
                )),
                Some(level) if !is_present(level) => {
                    complaints.push(format!("{VARIABLE}={name}: this machine does not have it"));
                }
                Some(_) => {}
            }
            level.filter(|&level| is_present(level))
        });
        let candidates = wanted.into_iter().chain(SimdLevel::ALL);
        let mut level = SimdLevel::Scalar;
        for candidate in candidates.filter(|&level| is_present(level)) {
            if candidate == SimdLevel::Scalar || passes_self_test(candidate) {
                level = candidate;
                break;
            }
            let complaint = format!("{candidate} gives wrong results on this machine");
            if !complaints.contains(&complaint) {
                complaints.push(complaint);
            }
        }
        let complaint = (!complaints.is_empty()).then(|| complaints.join("; "));
        Self { level, complaint }
    }
}

/// One line for people.
impl fmt::Display for SimdChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        write!(formatter, "classifies with {}", self.level)?;
        match &self.complaint {
            Some(complaint) => write!(formatter, " ({complaint})"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_of_this_machine_passes_its_test() {
        let levels = SimdLevel::available();
        assert_eq!(levels.last(), Some(&SimdLevel::Scalar));
        let present = SimdLevel::ALL.into_iter().filter(|level| level.is_present());
        assert_eq!(levels, present.collect::<Vec<_>>());
        runtime::tell!("levels: {levels:?}");
    }

    #[test]
    fn the_fastest_level_that_works_is_chosen() {
        use SimdLevel::{Avx2, Avx512, Scalar, Sse42};
        let intel = |level| level != SimdLevel::Neon;
        let old = |level| matches!(level, Sse42 | Scalar);
        let all_right = |_| true;
        let avx_wrong = |level| !matches!(level, Avx512 | Avx2);

        let chosen = SimdChoice::new(None, intel, all_right);
        assert_eq!(chosen, SimdChoice { level: Avx512, complaint: None });
        assert_eq!(chosen.to_string(), "classifies with avx512");
        assert_eq!(SimdChoice::new(Some("avx2"), intel, all_right).level, Avx2);
        assert_eq!(SimdChoice::new(Some(""), old, all_right).level, Sse42);
        assert_eq!(
            SimdChoice::new(Some("scalar"), intel, all_right).to_string(),
            "classifies with scalar"
        );

        let lines = [
            (
                SimdChoice::new(Some("avx2"), old, all_right),
                "classifies with sse4.2 (TOUCHLINE_SIMD=avx2: this machine does not have it)",
            ),
            (
                SimdChoice::new(Some("AVX"), old, all_right),
                "classifies with sse4.2 (TOUCHLINE_SIMD=AVX is unknown, \
                 it can be avx512, avx2, sse4.2, neon, scalar)",
            ),
            (
                SimdChoice::new(None, intel, avx_wrong),
                "classifies with sse4.2 (avx512 gives wrong results on this machine; \
                 avx2 gives wrong results on this machine)",
            ),
            (
                SimdChoice::new(Some("avx2"), intel, avx_wrong),
                "classifies with sse4.2 (avx2 gives wrong results on this machine; \
                 avx512 gives wrong results on this machine)",
            ),
            (
                SimdChoice::new(None, |level| level == Avx2 || level == Scalar, |_| false),
                "classifies with scalar (avx2 gives wrong results on this machine)",
            ),
        ];
        for (choice, line) in lines {
            assert_eq!(choice.to_string(), line);
        }
    }
}
