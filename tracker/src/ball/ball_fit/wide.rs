//! Numbers for calculations that are the same in every sector of the rim: one sector after the other, or four
//! at a time.

use std::ops::{Add, Div, Mul, Sub};

/// A number, or several that are calculated with together.
pub(super) trait Number:
    Copy + Default + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    fn of(value: f64) -> Self;
    fn abs(self) -> Self;
    fn at_least(self, least: f64) -> Self;
}

impl Number for f64 {
    fn of(value: f64) -> Self {
        value
    }

    fn abs(self) -> Self {
        f64::abs(self)
    }

    fn at_least(self, least: f64) -> Self {
        self.max(least)
    }
}

/// Numbers in a [`Wide`].
pub(super) const LANES: usize = 4;

/// Four numbers. Within [`dispatch!`](fearless_simd::dispatch) the compiler makes one instruction of each
/// operation; the results are those of single numbers on every machine.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(32))]
pub(super) struct Wide(pub [f64; LANES]);

impl Wide {
    #[inline(always)]
    fn with(self, other: Self, operation: impl Fn(f64, f64) -> f64) -> Self {
        Self(std::array::from_fn(|lane| operation(self.0[lane], other.0[lane])))
    }

    /// The sum of all four.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        let [a, b, c, d] = self.0;
        (a + b) + (c + d)
    }
}

impl Number for Wide {
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(f64::abs))
    }

    #[inline(always)]
    fn at_least(self, least: f64) -> Self {
        Self(self.0.map(|value| value.max(least)))
    }
}

impl Add for Wide {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(other, |a, b| a + b)
    }
}

impl Sub for Wide {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(other, |a, b| a - b)
    }
}

impl Mul for Wide {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(other, |a, b| a * b)
    }
}

impl Div for Wide {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.with(other, |a, b| a / b)
    }
}
