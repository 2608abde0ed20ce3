//! What the kernels need of an instruction set beyond what the library offers for all of them.

use super::prefilter::ChannelFilter;
use fearless_simd::prelude::*;
#[cfg(target_arch = "x86_64")]
use fearless_simd::x86::{Avx2, Avx512, Sse4_2};
#[cfg(target_arch = "aarch64")]
use fearless_simd::{aarch64::Neon, u8x16};
#[cfg(target_arch = "x86_64")]
use fearless_simd::{u8x16, u8x32, u8x64};
#[cfg(target_arch = "aarch64")]
use std::arch::aarch64::*;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

/// Widest register.
pub const MAX_LANES: usize = 64;

/// Narrowest register.
pub const MIN_LANES: usize = 16;

/// Registers of bytes, as many as the machine has room for.
///
/// Everything here, and everything that calls it up to `vectorize`, is `#[inline(always)]`: a
/// function or closure without it is compiled for the oldest machine, and every instruction becomes
/// a call. All tests stay green then, and a frame takes eight times as long (two such closures: 693
/// µs rather than 85).
pub trait Lanes: Simd {
    /// A channel's table of the prefilter in a register.
    type Table: Copy;

    /// Loads a table.
    fn table(self, filter: &ChannelFilter) -> Self::Table;

    /// The entry for each value.
    fn look_up(self, table: Self::Table, values: Self::u8s) -> Self::u8s;

    /// (a + b + 1) / 2, rounded down, of each pair of bytes. One instruction wherever there is one,
    /// which the library does not offer; it would be four of those that it does.
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s;

    /// A bit for each pixel that passes the prefilter.
    #[inline(always)]
    fn passing(self, [a, b, c]: [Self::u8s; 3], filters: [Self::Table; 3]) -> u64 {
        let buckets =
            self.look_up(filters[0], a) & self.look_up(filters[1], b) & self.look_up(filters[2], c);
        !buckets.simd_eq(0).to_bitmask() & (!0 >> (MAX_LANES - Self::u8s::LEN))
    }
}

/// A table of 16 entries in each 16 bytes of a register.
macro_rules! sixteen_entries {
    () => {
        type Table = Self::u8s;

        #[inline(always)]
        fn table(self, filter: &ChannelFilter) -> Self::Table {
            Self::u8s::block_splat(u8x16::from_slice(self, &filter.coarse))
        }

        #[inline(always)]
        fn look_up(self, table: Self::Table, values: Self::u8s) -> Self::u8s {
            table.swizzle_dyn_within_blocks(values >> 4)
        }
    };
}

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx512 {
    type Table = u8x64<Self>;

    #[inline(always)]
    fn table(self, filter: &ChannelFilter) -> Self::Table {
        u8x64::from_slice(self, &filter.fine)
    }

    /// 64 entries fill a register, and one VBMI instruction looks up among all of them.
    #[inline(always)]
    fn look_up(self, table: Self::Table, values: Self::u8s) -> Self::u8s {
        table.swizzle_dyn(values >> 2)
    }

    #[inline(always)]
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn mean(simd: Avx512, a: u8x64<Avx512>, b: u8x64<Avx512>) -> u8x64<Avx512> {
                _mm512_avg_epu8(a.into(), b.into()).simd_into(simd)
            }
        );
        mean(self, a, b)
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for Avx2 {
    sixteen_entries!();

    #[inline(always)]
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn mean(simd: Avx2, a: u8x32<Avx2>, b: u8x32<Avx2>) -> u8x32<Avx2> {
                _mm256_avg_epu8(a.into(), b.into()).simd_into(simd)
            }
        );
        mean(self, a, b)
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for Sse4_2 {
    sixteen_entries!();

    #[inline(always)]
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn mean(simd: Sse4_2, a: u8x16<Sse4_2>, b: u8x16<Sse4_2>) -> u8x16<Sse4_2> {
                _mm_avg_epu8(a.into(), b.into()).simd_into(simd)
            }
        );
        mean(self, a, b)
    }
}

#[cfg(target_arch = "aarch64")]
impl Lanes for Neon {
    sixteen_entries!();

    #[inline(always)]
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn mean(simd: Neon, a: u8x16<Neon>, b: u8x16<Neon>) -> u8x16<Neon> {
                vrhaddq_u8(a.into(), b.into()).simd_into(simd)
            }
        );
        mean(self, a, b)
    }
}
