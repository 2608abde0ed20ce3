//! Sums over the pixels at each edge around a body: the input of the [edge fit](crate::edges::edge_fit).
//!
//! For each pixel within reach the edge map names the edge that shows there. With n the edge's normal and d
//! the pixel's distance inside it, the sample's model and its derivatives by the step (x, y, θ) are
//!
//! w = W(d / σ), j₀ = −W′·nₓ/σ, j₁ = −W′·n_y/σ, j₂ = −W′·(n_y·x − nₓ·y)/(σ·lever).
//!
//! Sums of their products with each other and with the level are all that the normal equations need, so
//! each pixel is read once in a pass. Each step is a branch-free loop over arrays, which the compiler turns
//! into vector instructions; [`EdgePixels::sum_up`] picks the widest that the machine has. The order of
//! additions does not depend on the width, so a picture gives the same result on every machine.

use super::local_map::{LocalMap, RowMap};
use super::{EdgeMap, MAX_STRETCHES, NO_EDGE};
use crate::raw::{CHANNELS, RawFrame};
use fearless_simd::{Level, dispatch};

/// Standard deviation of the point spread function, px. A value that is wrong by a quarter moves the fit by
/// a hundredth of a pixel: the errors on both sides of an edge cancel.
pub(crate) const PSF_SIGMA_PX: f32 = 0.62;
/// Offset of grey levels that keeps sums of squares small, and so exact in single precision.
const MIDDLE_LEVEL: f32 = 96.0;
/// Pixels that are buffered before those at edges are added up; a body mostly has fewer.
const MOST_PIXELS: usize = 1024;
/// Most pixels of a row that are buffered at once.
const ROW_PIXELS: usize = 256;
/// Pixels at edges that are added up together: the lanes of a register.
const LANES: usize = 8;

/// Sums over the samples of one stretch and channel. w is the fraction of a pixel's light from inside the
/// edge, j its derivatives by the step, i the level less [`MIDDLE_LEVEL`]. Groups of four are added by one
/// instruction; the alignment keeps each within a cache line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(align(64))]
pub(crate) struct Sums {
    /// j₀, j₁, j₂, w.
    pub plain: [f32; 4],
    /// The same, times w.
    pub by_w: [f32; 4],
    /// The same, times i.
    pub by_i: [f32; 4],
    /// j₀j₀, j₀j₁, j₀j₂, i.
    pub first: [f32; 4],
    /// j₁j₁, j₁j₂, j₂j₂, ii.
    pub rest: [f32; 4],
    pub n: f32,
}

/// Accumulates the sums, reusing its memory.
#[derive(Debug, Clone)]
pub(crate) struct EdgePixels {
    level: Level,
    /// One over the lever arm that turns headings into millimetres.
    per_lever: f32,
    /// By stretch, then by channel.
    sums: Box<[Sums; MAX_STRETCHES * CHANNELS]>,
    pixels: Box<Pixels>,
}

/// Buffered pixels around a body.
#[derive(Debug, Clone)]
struct Pixels {
    count: usize,
    /// Place in the body's frame, in millimetres.
    x: [f32; MOST_PIXELS],
    y: [f32; MOST_PIXELS],
    /// Cell of the edge map.
    cell: [u32; MOST_PIXELS],
    /// Row (upper half of the word) and column (lower half).
    place: [u32; MOST_PIXELS],
    /// Pixels at edges: index of the pixel (upper half) and of its edge (lower half).
    found: [u32; MOST_PIXELS],
}

impl EdgePixels {
    pub fn new(lever_mm: f64) -> Self {
        Self {
            level: Level::new(),
            per_lever: 1.0 / lever_mm as f32,
            sums: Box::new([Sums::default(); MAX_STRETCHES * CHANNELS]),
            pixels: Box::new(Pixels {
                count: 0,
                x: [0.0; MOST_PIXELS],
                y: [0.0; MOST_PIXELS],
                cell: [0; MOST_PIXELS],
                place: [0; MOST_PIXELS],
                found: [0; MOST_PIXELS],
            }),
        }
    }

    /// The sums of each stretch of `edges`, by channel, for a body at the pose of `map`.
    pub fn sum_up(&mut self, edges: &EdgeMap, frame: &RawFrame, map: &LocalMap) -> &[Sums] {
        let count = edges.stretch_count * CHANNELS;
        self.sums[..count].fill(Sums::default());
        dispatch!(self.level, _simd => self.add_picture(edges, frame, map));
        &self.sums[..count]
    }

    #[inline(always)]
    fn add_picture(&mut self, edges: &EdgeMap, frame: &RawFrame, map: &LocalMap) {
        let reach_px = map.most_px(edges.reach_mm);
        let (center_x, center_y) = (map.center.x_px, map.center.y_px);
        // The conversion to usize saturates negative numbers at 0.
        let rows = (center_y - reach_px).ceil() as usize
            ..(((center_y + reach_px).floor() + 1.0) as usize).min(frame.height);
        let per_psf = 1.0 / (PSF_SIGMA_PX * SPLINE_DEVIATIONS * map.mm_per_px());
        for row_index in rows {
            let v = row_index as f64 - center_y;
            let half = (reach_px * reach_px - v * v).max(0.0).sqrt();
            let columns = (center_x - half).ceil() as usize
                ..(((center_x + half).floor() + 1.0) as usize).min(frame.width);
            let row_map = map.row(v as f32);
            let mut begin = columns.start;
            while begin < columns.end {
                let end = columns.end.min(begin + ROW_PIXELS);
                let first_u = (begin as f64 - center_x) as f32;
                self.place(edges, &row_map, first_u, [row_index, begin], end - begin);
                if self.pixels.count > MOST_PIXELS - ROW_PIXELS {
                    self.add(edges, frame, per_psf);
                }
                begin = end;
            }
        }
        self.add(edges, frame, per_psf);
    }

    /// Buffers `count` pixels of a row, the first of which has this row and column, with their places in the
    /// body's frame.
    #[inline(always)]
    fn place(
        &mut self,
        edges: &EdgeMap,
        &[[x0, x1, x2], [y0, y1, y2]]: &RowMap,
        first_u: f32,
        [row, column]: [usize; 2],
        count: usize,
    ) {
        let Pixels { count: before, x, y, cell, place, .. } = &mut *self.pixels;
        // Fills whole registers; the surplus pixels get a cell without an edge.
        let whole = *before..*before + count.next_multiple_of(LANES);
        let first = (row << 16 | column) as u32;
        let places = x[whole.clone()].iter_mut().zip(&mut y[whole.clone()]);
        let cells = cell[whole.clone()].iter_mut().zip(&mut place[whole.clone()]);
        for (index, ((x, y), (cell, place))) in (0u32..).zip(places.zip(cells)) {
            let u = first_u + index as i32 as f32;
            (*x, *y) = (x0 + u * (x1 + u * x2), y0 + u * (y1 + u * y2));
            let at = edges.cell_at(*x, *y);
            *cell = if index < count as u32 { at } else { EdgeMap::EMPTY_CELL };
            *place = first + index;
        }
        *before = whole.end;
    }

    /// Adds the buffered pixels at edges to the sums, and empties the buffer.
    #[inline(always)]
    fn add(&mut self, edges: &EdgeMap, frame: &RawFrame, per_psf: f32) {
        let Pixels { count, x, y, cell, place, found } = &mut *self.pixels;
        let mut found_count = 0;
        for (index, &cell) in (0u32..).zip(&cell[..std::mem::take(count)]) {
            let edge = edges.in_cell(cell);
            // Never beyond the array; the remainder spares the bounds check.
            found[found_count % MOST_PIXELS] = index << 16 | u32::from(edge);
            found_count += usize::from(edge != NO_EDGE);
        }
        // The surplus lanes of the last register refer to pixel 0, which exists.
        found[found_count..found_count.next_multiple_of(LANES)].fill(0);
        for group in (0..found_count).step_by(LANES) {
            let found = &found[group..group + LANES];
            let [mut px, mut py] = [[0.0; LANES]; 2];
            let mut pixel = [0; LANES];
            let [mut nx, mut ny, mut inside_mm] = [[0.0; LANES]; 3];
            let mut stretch = [0; LANES];
            for lane in 0..LANES {
                let index = (found[lane] >> 16) as usize % MOST_PIXELS;
                (px[lane], py[lane], pixel[lane]) = (x[index], y[index], place[index]);
                let at = edges.edge(found[lane] as u16);
                [nx[lane], ny[lane]] = at.normal;
                inside_mm[lane] = -at.offset_mm;
                stretch[lane] = at.stretch as usize;
            }
            let [mut w, mut j0, mut j1, mut j2] = [[0.0; LANES]; 4];
            for lane in 0..LANES {
                let (nx, ny, x, y) = (nx[lane], ny[lane], px[lane], py[lane]);
                let (share, density) = spread((nx * x + ny * y + inside_mm[lane]) * per_psf);
                // A step of the body moves the pixel the other way within it.
                let slope = -density * per_psf;
                w[lane] = share;
                j0[lane] = slope * nx;
                j1[lane] = slope * ny;
                j2[lane] = slope * (ny * x - nx * y) * self.per_lever;
            }
            for index in 0..frame.samples_per_pixel {
                for lane in 0..LANES.min(found_count - group) {
                    let (row, column) =
                        ((pixel[lane] >> 16) as usize, (pixel[lane] & 0xffff) as usize);
                    let (channel, value) = frame.sample(row, column, index);
                    let sample = [j0[lane], j1[lane], j2[lane], w[lane]];
                    let sums = &mut self.sums[stretch[lane] * CHANNELS + channel];
                    sums.add(sample, value - MIDDLE_LEVEL);
                }
            }
        }
    }
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, sample: [f32; 4], i: f32) {
        let [j0, j1, j2, w] = sample;
        let first = [[j0, j0, j0, i], [j0, j1, j2, 1.0]];
        let rest = [[j1, j1, j2, i], [j1, j2, j2, i]];
        for lane in 0..4 {
            self.plain[lane] += sample[lane];
            self.by_w[lane] += w * sample[lane];
            self.by_i[lane] += i * sample[lane];
            self.first[lane] += first[0][lane] * first[1][lane];
            self.rest[lane] += rest[0][lane] * rest[1][lane];
        }
        self.n += 1.0;
    }
}

/// Width of a box of the point spread function in its standard deviations, √3. The function is a cubic
/// B-spline, the convolution of four boxes (pixel, filter and lens make about as many): close to a normal
/// distribution, but of finite reach and without an exponential.
pub(crate) const SPLINE_DEVIATIONS: f32 = 1.732_050_8;

/// Integral and density of the point spread function at a distance inside an edge, in units of
/// [`SPLINE_DEVIATIONS`] standard deviations.
#[inline(always)]
pub(crate) fn spread(inside: f32) -> (f32, f32) {
    let t = inside.abs();
    let (outer, inner) = ((2.0 - t).max(0.0), (1.0 - t).max(0.0));
    let (outer_3, inner_3) = (outer * outer * outer, inner * inner * inner);
    let density = (outer_3 - 4.0 * inner_3) * (1.0 / 6.0);
    let beyond = (outer_3 * outer - 4.0 * inner_3 * inner) * (1.0 / 24.0);
    (if inside < 0.0 { beyond } else { 1.0 - beyond }, density)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Pair;
    use geometry::{CameraModel, FieldPoint, Pose};
    use messages::{FrameHeader, PixelFormat};
    use proptest::prelude::*;

    #[test]
    fn the_point_spread_function_is_nearly_a_normal_distribution() {
        let sigma = |z: f32| spread(z / SPLINE_DEVIATIONS);
        for (z, expected) in [(0.0, 0.5), (1.0, 0.841_345), (-1.96, 0.024_998), (9.0, 1.0)] {
            assert!((sigma(z).0 - expected).abs() < 0.008, "{z}: {:?}", sigma(z));
        }
        // The density is the derivative.
        for step in -50..50 {
            let t = step as f32 * 0.043;
            let slope = (spread(t + 0.01).0 - spread(t - 0.01).0) / 0.02;
            assert!((slope - spread(t).1).abs() < 1e-3, "{t}");
        }
        // Its standard deviation is 1 in these units.
        let (mut variance, step) = (0.0, 0.001);
        for index in -4000..4000 {
            let z = index as f32 * step;
            variance += z * z * spread(z / SPLINE_DEVIATIONS).1 / SPLINE_DEVIATIONS * step;
        }
        assert!((variance - 1.0).abs() < 0.01, "{variance}");
    }

    const SQUARE: [Pair; 4] = [[-17.0, -17.0], [17.0, -17.0], [17.0, 17.0], [-17.0, 17.0]];

    proptest! {
        /// All SIMD levels give the same sums, and a plain loop over the pixels agrees.
        #[test]
        fn all_machines_get_the_same(
            seed in any::<u64>(),
            x in -1200.0..1200.0f64,
            y in -900.0..900.0f64,
            orientation in -3.0..3.0f64,
            rgb in any::<bool>(),
        ) {
            let config = config::Config::default();
            let (width, height) = (config.camera.width, config.camera.height);
            let format = if rgb { PixelFormat::Rgb24 } else { PixelFormat::Bayer8 };
            let stride = format.row_bytes(width) as usize;
            let mut state = seed | 1;
            let pixels: Vec<u8> = (0..stride * height as usize)
                .map(|_| {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    (state >> 24) as u8
                })
                .collect();
            let header = FrameHeader {
                width,
                height,
                stride: stride as u32,
                pixel_format: format as u32,
                ..FrameHeader::default()
            };
            let frame = RawFrame::new(&header, &pixels, width, height).unwrap();
            let camera = CameraModel::new(&config.geometry, width, height).unwrap();
            let inside = |[x, y]: Pair| (x.abs().max(y.abs()) < 17.0).then_some(0);
            let edges = EdgeMap::new(&[&SQUARE], inside, 3.5);
            let pose = Pose { position: FieldPoint::new(x, y), orientation };
            let map = LocalMap::new(&camera, &pose, 50.0, edges.reach_mm, 3.5).unwrap();
            let mut pixels = EdgePixels::new(20.0);
            let best = pixels.sum_up(&edges, &frame, &map).to_vec();
            let mut plain = EdgePixels { level: Level::baseline(), ..EdgePixels::new(20.0) };
            prop_assert_eq!(&best, &plain.sum_up(&edges, &frame, &map).to_vec());

            let mut expected = vec![[0.0; 4]; best.len()];
            for row in 0..frame.height {
                let v = (row as f64 - map.center.y_px) as f32;
                let [[x0, x1, x2], [y0, y1, y2]] = map.row(v);
                for column in 0..frame.width {
                    let u = (column as f64 - map.center.x_px) as f32;
                    let (x, y) = (x0 + u * (x1 + u * x2), y0 + u * (y1 + u * y2));
                    let edge = edges.in_cell(edges.cell_at(x, y));
                    if edge == NO_EDGE {
                        continue;
                    }
                    let edge = edges.edge(edge);
                    let off = edge.normal[0] * x + edge.normal[1] * y - edge.offset_mm;
                    let (w, _) = spread(off / (PSF_SIGMA_PX * SPLINE_DEVIATIONS * map.mm_per_px()));
                    let samples = 0..frame.samples_per_pixel;
                    for (channel, value) in samples.map(|index| frame.sample(row, column, index)) {
                        let i = f64::from(value - MIDDLE_LEVEL);
                        let sums = &mut expected[edge.stretch as usize * CHANNELS + channel];
                        let terms = [1.0, f64::from(w), i, i * i];
                        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                    }
                }
            }
            for (sums, [n, w, i, ii]) in best.iter().zip(expected) {
                // Rounding may put a pixel into the next cell of the map.
                let is_near = |sum: f32, exact: f64, part: f64| {
                    (f64::from(sum) - exact).abs() <= part * (1.0 + n)
                };
                prop_assert!(is_near(sums.n, n, 0.02), "{n} {sums:?}");
                prop_assert!(is_near(sums.plain[3], w, 0.02), "{w} {sums:?}");
                prop_assert!(is_near(sums.first[3], i, 4.0), "{i} {sums:?}");
                prop_assert!(is_near(sums.rest[3], ii, 600.0), "{ii} {sums:?}");
            }
        }
    }
}
