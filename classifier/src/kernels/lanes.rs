//! Operations that the kernels need besides those that the library offers for all instruction sets.

use super::prefilter::ChannelFilter;
#[cfg(target_arch = "x86_64")]
use crate::second_look_tables::{Bytes, COLOR_LOG, GREY_LOG};
use crate::second_look_tables::{KEYS, LOG};
use fearless_simd::prelude::*;
#[cfg(target_arch = "x86_64")]
use fearless_simd::x86::{Avx2, Avx512, Sse4_2};
#[cfg(target_arch = "aarch64")]
use fearless_simd::{aarch64::Neon, u8x16, u16x8};
#[cfg(target_arch = "x86_64")]
use fearless_simd::{u8x16, u8x32, u8x64, u16x8, u16x16, u16x32};
#[cfg(target_arch = "aarch64")]
use std::arch::aarch64::*;
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

/// Bytes in the widest register.
pub const MAX_LANES: usize = 64;

/// Bytes in the narrowest register.
pub const MIN_LANES: usize = 16;

/// Registers of bytes, of the machine's width.
///
/// Everything here, and everything that calls it up to `vectorize`, is `#[inline(always)]`: a function or
/// closure without it is compiled for the oldest machine, and every instruction becomes a call. All tests
/// still pass then, but a frame takes eight times as long (two such closures: 693 µs rather than 85).
pub trait Lanes: Simd {
    /// A channel's table of the prefilter in a register.
    type Table: Copy;

    /// Loads a table.
    fn table(self, filter: &ChannelFilter) -> Self::Table;

    /// The entry for each value.
    fn look_up(self, table: Self::Table, values: Self::u8s) -> Self::u8s;

    /// (a + b + 1) / 2, rounded down, of each pair of bytes. A single instruction on every supported machine,
    /// which the library does not offer; four of those that it offers.
    fn mean(self, a: Self::u8s, b: Self::u8s) -> Self::u8s;

    /// Each byte times its gain in 256ths, rounded, at most 255. Gains are below 2¹⁵, those of the lower half of
    /// the bytes first.
    ///
    /// With v the byte and g the gain, machines round and saturate in the same steps:
    /// (2⁷·v·g + 2¹⁴) / 2¹⁵ = (v·g + 128) / 256 is one instruction, and so is the conversion to bytes.
    fn scaled(self, values: Self::u8s, gains: [Self::u16s; 2]) -> Self::u8s;

    /// The entry for each key, below [`KEYS`].
    fn look_up_key(self, table: Self::Table, keys: Self::u8s) -> Self::u8s;

    /// The [logarithm](LOG) of each value.
    fn log(self, values: Self::u8s) -> Self::u8s;

    /// The entry of [`COLOR_LOG`] for each value.
    fn color_log(self, values: Self::u8s) -> Self::u8s;

    /// The entry of [`GREY_LOG`] for each value.
    fn grey_log(self, values: Self::u8s) -> Self::u8s;

    /// The buckets for which the prefilter passes each pixel.
    #[inline(always)]
    fn buckets(self, [a, b, c]: [Self::u8s; 3], filters: [Self::Table; 3]) -> Self::u8s {
        self.look_up(filters[0], a) & self.look_up(filters[1], b) & self.look_up(filters[2], c)
    }

    /// A bit for each pixel with at least one bucket.
    #[inline(always)]
    fn any_bucket(self, buckets: Self::u8s) -> u64 {
        !buckets.simd_eq(0).to_bitmask() & (!0 >> (MAX_LANES - Self::u8s::LEN))
    }

    /// A bit for each pixel that passes the prefilter.
    #[inline(always)]
    fn passing(self, values: [Self::u8s; 3], filters: [Self::Table; 3]) -> u64 {
        self.any_bucket(self.buckets(values, filters))
    }
}

/// A table of 16 entries, repeated in each 16 bytes of a register.
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

        #[inline(always)]
        fn look_up_key(self, table: Self::Table, keys: Self::u8s) -> Self::u8s {
            table.swizzle_dyn_within_blocks(keys >> 2)
        }

        /// Value for the upper four bits, plus the increment for the lower ones.
        #[inline(always)]
        fn log(self, values: Self::u8s) -> Self::u8s {
            const OF_UPPER: [u8; 16] = {
                let mut table = [0; 16];
                let mut upper = 0;
                while upper < 16 {
                    table[upper] = LOG.0[16 * upper];
                    upper += 1;
                }
                table
            };
            let (upper, lower) = (values >> 4, values & 15);
            let of_upper = Self::u8s::block_splat(u8x16::from_slice(self, &OF_UPPER));
            let of_small = Self::u8s::block_splat(u8x16::from_slice(self, &LOG.0[..16]));
            let added = upper
                .simd_lt(4)
                .select(lower >> 1, upper.simd_lt(8).select(lower >> 2, lower >> 3));
            let added = upper.simd_lt(2).select(lower, added);
            let large = of_upper.swizzle_dyn_within_blocks(upper) + added;
            upper.simd_eq(0).select(of_small.swizzle_dyn_within_blocks(lower), large)
        }

        #[inline(always)]
        fn color_log(self, values: Self::u8s) -> Self::u8s {
            let log = self.grey_log(values);
            log.simd_eq(0).select(log, log + KEYS as u8 / 2)
        }

        #[inline(always)]
        fn grey_log(self, values: Self::u8s) -> Self::u8s {
            self.log(values) >> 1
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

    /// The instruction uses the lower six bits only.
    #[inline(always)]
    fn look_up_key(self, table: Self::Table, keys: Self::u8s) -> Self::u8s {
        table.swizzle_dyn(keys)
    }

    #[inline(always)]
    fn log(self, values: Self::u8s) -> Self::u8s {
        map_all(self, &LOG, values)
    }

    #[inline(always)]
    fn color_log(self, values: Self::u8s) -> Self::u8s {
        map_all(self, &COLOR_LOG, values)
    }

    #[inline(always)]
    fn grey_log(self, values: Self::u8s) -> Self::u8s {
        map_all(self, &GREY_LOG, values)
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

    #[inline(always)]
    fn scaled(self, values: Self::u8s, gains: [Self::u16s; 2]) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn scaled(
                simd: Avx512,
                values: u8x64<Avx512>,
                low_gains: u16x32<Avx512>,
                high_gains: u16x32<Avx512>,
            ) -> u8x64<Avx512> {
                let values = values.into();
                let low = _mm512_cvtepu8_epi16(_mm512_castsi512_si256(values));
                let high = _mm512_cvtepu8_epi16(_mm512_extracti64x4_epi64::<1>(values));
                let low = _mm512_mulhrs_epi16(_mm512_slli_epi16::<7>(low), low_gains.into());
                let high = _mm512_mulhrs_epi16(_mm512_slli_epi16::<7>(high), high_gains.into());
                // Packs within each 16 bytes; the words of 8 bytes are put in order.
                let order = _mm512_setr_epi64(0, 2, 4, 6, 1, 3, 5, 7);
                _mm512_permutexvar_epi64(order, _mm512_packus_epi16(low, high)).simd_into(simd)
            }
        );
        scaled(self, values, gains[0], gains[1])
    }
}

/// The entry of a 256-entry table for each value: two look-ups among 128 entries by the lower seven bits.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn map_all(simd: Avx512, table: &Bytes, values: u8x64<Avx512>) -> u8x64<Avx512> {
    fearless_simd::kernel!(
        #[inline(always)]
        fn look_up(
            simd: Avx512,
            table: [u8x64<Avx512>; 4],
            values: u8x64<Avx512>,
        ) -> u8x64<Avx512> {
            let [a, b, c, d] = table;
            let values = values.into();
            let lower = _mm512_permutex2var_epi8(a.into(), values, b.into());
            let upper = _mm512_permutex2var_epi8(c.into(), values, d.into());
            _mm512_mask_blend_epi8(_mm512_movepi8_mask(values), lower, upper).simd_into(simd)
        }
    );
    let [a, b, c, d] = table.0.as_chunks::<64>().0 else { unreachable!("256 is four times 64") };
    let load = [
        u8x64::from_slice(simd, a),
        u8x64::from_slice(simd, b),
        u8x64::from_slice(simd, c),
        u8x64::from_slice(simd, d),
    ];
    look_up(simd, load, values)
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

    #[inline(always)]
    fn scaled(self, values: Self::u8s, gains: [Self::u16s; 2]) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn scaled(
                simd: Avx2,
                values: u8x32<Avx2>,
                low_gains: u16x16<Avx2>,
                high_gains: u16x16<Avx2>,
            ) -> u8x32<Avx2> {
                let values = values.into();
                let low = _mm256_cvtepu8_epi16(_mm256_castsi256_si128(values));
                let high = _mm256_cvtepu8_epi16(_mm256_extracti128_si256::<1>(values));
                let low = _mm256_mulhrs_epi16(_mm256_slli_epi16::<7>(low), low_gains.into());
                let high = _mm256_mulhrs_epi16(_mm256_slli_epi16::<7>(high), high_gains.into());
                // Packs within each 16 bytes; the words of 8 bytes are put in order.
                let packed = _mm256_packus_epi16(low, high);
                _mm256_permute4x64_epi64::<0b11_01_10_00>(packed).simd_into(simd)
            }
        );
        scaled(self, values, gains[0], gains[1])
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

    #[inline(always)]
    fn scaled(self, values: Self::u8s, gains: [Self::u16s; 2]) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn scaled(
                simd: Sse4_2,
                values: u8x16<Sse4_2>,
                low_gains: u16x8<Sse4_2>,
                high_gains: u16x8<Sse4_2>,
            ) -> u8x16<Sse4_2> {
                let (values, zero) = (values.into(), _mm_setzero_si128());
                // 2⁸·v, and half of it.
                let low = _mm_srli_epi16::<1>(_mm_unpacklo_epi8(zero, values));
                let high = _mm_srli_epi16::<1>(_mm_unpackhi_epi8(zero, values));
                let low = _mm_mulhrs_epi16(low, low_gains.into());
                let high = _mm_mulhrs_epi16(high, high_gains.into());
                _mm_packus_epi16(low, high).simd_into(simd)
            }
        );
        scaled(self, values, gains[0], gains[1])
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

    #[inline(always)]
    fn scaled(self, values: Self::u8s, gains: [Self::u16s; 2]) -> Self::u8s {
        fearless_simd::kernel!(
            #[inline(always)]
            fn scaled(
                simd: Neon,
                values: u8x16<Neon>,
                low_gains: u16x8<Neon>,
                high_gains: u16x8<Neon>,
            ) -> u8x16<Neon> {
                let values = values.into();
                let low = vreinterpretq_s16_u16(vshll_n_u8::<7>(vget_low_u8(values)));
                let high = vreinterpretq_s16_u16(vshll_n_u8::<7>(vget_high_u8(values)));
                let low = vqrdmulhq_s16(low, vreinterpretq_s16_u16(low_gains.into()));
                let high = vqrdmulhq_s16(high, vreinterpretq_s16_u16(high_gains.into()));
                vcombine_u8(vqmovun_s16(low), vqmovun_s16(high)).simd_into(simd)
            }
        );
        scaled(self, values, gains[0], gains[1])
    }
}
