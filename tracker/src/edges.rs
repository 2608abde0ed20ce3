//! Edge map: a table of a robot's top with the edge, if any, that a pixel at each place shows.
//!
//! Only edges that can be located count: the visible ends of patches, straight or gently curved, with no
//! other edge and no corner so near that the point spread function mixes them. Edges are joined into
//! *stretches*, along which each side has one colour.

pub(crate) mod edge_fit;
pub(crate) mod edge_pixels;
pub(crate) mod local_map;

use config::Pair;

/// Half the width of an edge's band: the levels on both sides must be visible.
const BAND_PX: f64 = 2.25;
/// Least distance of other edges. At two standard deviations of the point spread function 2 % of the light is
/// mixed.
const CLEAR_PX: f64 = 1.25;
/// Distance between the entries of the table. It does not limit the accuracy, because distances are computed
/// from the edge that an entry names; a small table stays in the nearest cache.
const STEP_PX: f64 = 0.35;
/// Distance between the points along an outline at which the visible patches on both sides are compared.
const SAMPLE_MM: f64 = 0.5;
/// Distance of these patches from the outline.
const BESIDE_MM: f64 = 0.2;
/// Largest angle between two edges of one stretch.
const GENTLE_DEG: f64 = 25.0;
/// Largest angle between the first and the last edge of a stretch.
const MOST_TURN_DEG: f64 = 100.0;
/// Most stretches and edges; further ones are left out. Layouts have up to a dozen.
pub(crate) const MAX_STRETCHES: usize = 48;
const MAX_EDGES: usize = 1000;
/// Most rows and columns of the table.
const MAX_SIDE: usize = 512;
/// Stands for a cell without an edge.
pub(crate) const NO_EDGE: u16 = u16::MAX;

/// A straight edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Edge {
    /// Unit normal, pointing into the patch.
    pub normal: [f32; 2],
    /// A point lies normal · point − `offset_mm` inside.
    pub offset_mm: f32,
    /// Index of its stretch.
    pub stretch: u32,
}

/// The edges of a top, by place.
#[derive(Debug, Clone)]
pub(crate) struct EdgeMap {
    edges: Vec<Edge>,
    pub stretch_count: usize,
    /// Largest distance from the origin at which a pixel shows an edge.
    pub reach_mm: f64,
    /// Size of the pixels that the map is made for.
    pub mm_per_px: f64,
    side: usize,
    cells_per_mm: f32,
    cells: Vec<u16>,
}

/// A visible piece of an outline, from `a` to `b`.
#[derive(Debug, Clone, Copy)]
struct Piece {
    a: Pair,
    b: Pair,
    normal: Pair,
    stretch: usize,
}

impl EdgeMap {
    /// The edges of areas with the given outlines, for pictures with pixels of about `mm_per_px`. `topmost`
    /// returns the area that is visible at a point.
    pub fn new(
        outlines: &[&[Pair]],
        topmost: impl Fn(Pair) -> Option<usize>,
        mm_per_px: f64,
    ) -> Self {
        let mut pieces = Vec::new();
        for (patch, outline) in outlines.iter().enumerate() {
            add_pieces(patch, outline, &topmost, &mut pieces);
        }
        pieces.retain(|piece| piece.stretch < MAX_STRETCHES);
        pieces.truncate(MAX_EDGES);
        let (band_mm, clear_mm) = (BAND_PX * mm_per_px, CLEAR_PX * mm_per_px);
        let farthest = |reach: f64, [x, y]: Pair| reach.max(x.hypot(y));
        let reach_mm =
            pieces.iter().flat_map(|piece| [piece.a, piece.b]).fold(0.0, farthest) + band_mm;
        // A border of empty cells stands for everything beyond the table.
        let step_mm = (STEP_PX * mm_per_px).max(2.0 * reach_mm / MAX_SIDE as f64);
        let side = (2.0 * reach_mm / step_mm).ceil() as usize + 2;
        let place = |index: usize| (index as f64 - 0.5) * step_mm - reach_mm;
        let is_border = |index: usize| index == 0 || index + 1 == side;
        let cells = (0..side * side)
            .map(|cell| match (cell % side, cell / side) {
                (column, row) if is_border(column) || is_border(row) => NO_EDGE,
                (column, row) => edge_at([place(column), place(row)], &pieces, band_mm, clear_mm),
            })
            .collect();
        let edges = pieces.iter().map(|piece| {
            let [nx, ny] = piece.normal;
            Edge {
                normal: [nx as f32, ny as f32],
                offset_mm: (nx * piece.a[0] + ny * piece.a[1]) as f32,
                stretch: piece.stretch as u32,
            }
        });
        let stretch_count = pieces.iter().map(|piece| piece.stretch + 1).max().unwrap_or(0);
        let cells_per_mm = (1.0 / step_mm) as f32;
        let edges = edges.collect();
        Self { edges, stretch_count, reach_mm, mm_per_px, side, cells_per_mm, cells }
    }

    /// A cell without an edge, at the border.
    pub const EMPTY_CELL: u32 = 0;

    /// Index of the cell in which a point of the top lies; of an empty cell for a point beyond it.
    #[inline(always)]
    pub fn cell_at(&self, x_mm: f32, y_mm: f32) -> u32 {
        // Adding 2²³ rounds to the nearest whole number and leaves it in the lowest bits: a conversion that
        // vector instructions have, other than the language's saturating one.
        const WHOLE: f32 = (1 << 23) as f32;
        let side = self.side as f32;
        let index = |value: f32| {
            let cell = (value + self.reach_mm as f32) * self.cells_per_mm + 0.5;
            // Comparisons in this form turn NaN into 0, and take one instruction each.
            let cell = if cell > 0.0 { cell } else { 0.0 };
            let cell = if cell < side - 1.0 { cell } else { side - 1.0 };
            cell + WHOLE - WHOLE
        };
        (index(y_mm) * side + index(x_mm) + WHOLE).to_bits() - WHOLE.to_bits()
    }

    /// Index of the edge in a cell, or [`NO_EDGE`].
    #[inline(always)]
    pub fn in_cell(&self, cell: u32) -> u16 {
        self.cells[cell as usize]
    }

    /// The edge of an index that is not [`NO_EDGE`].
    #[inline(always)]
    pub fn edge(&self, index: u16) -> &Edge {
        &self.edges[usize::from(index)]
    }
}

/// Adds the visible pieces of one patch's outline.
fn add_pieces(
    patch: usize,
    outline: &[Pair],
    topmost: &impl Fn(Pair) -> Option<usize>,
    pieces: &mut Vec<Piece>,
) {
    let first = pieces.len();
    let mut stretch = pieces.last().map_or(0, |piece| piece.stretch + 1);
    let mut turned_deg = 0.0;
    for (index, &a) in outline.iter().enumerate() {
        let b = outline[(index + 1) % outline.len()];
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        if length < 1e-6 {
            continue;
        }
        let along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
        let at = |s: f64| [a[0] + along[0] * s, a[1] + along[1] * s];
        let beside = |[x, y]: Pair, [nx, ny]: Pair, side: f64| {
            topmost([x + side * BESIDE_MM * nx, y + side * BESIDE_MM * ny])
        };
        let count = (length / SAMPLE_MM).ceil().max(1.0) as usize;
        let left = [-along[1], along[0]];
        let mut shown: Option<(f64, Pair)> = None;
        for sample in 0..=count {
            let s = (sample as f64 + 0.5) / count as f64 * length;
            let is_shown = |normal: Pair| {
                sample < count
                    && beside(at(s), normal, 1.0) == Some(patch)
                    && beside(at(s), normal, -1.0) != Some(patch)
            };
            let normal = [left, [-left[0], -left[1]]].into_iter().find(|&normal| is_shown(normal));
            match (shown, normal) {
                (None, Some(normal)) => shown = Some((s - length / count as f64 / 2.0, normal)),
                (Some((from, last)), normal) if normal != Some(last) => {
                    let piece = Piece {
                        a: at(from),
                        b: at(s - length / count as f64 / 2.0),
                        normal: last,
                        stretch,
                    };
                    push_piece(pieces, first, piece, &mut stretch, &mut turned_deg);
                    shown = normal.map(|normal| (s - length / count as f64 / 2.0, normal));
                }
                _ => {}
            }
        }
    }
}

/// Adds a piece to the stretch of the piece before it if it continues that, else to a new stretch.
fn push_piece(
    pieces: &mut Vec<Piece>,
    first: usize,
    mut piece: Piece,
    stretch: &mut usize,
    turned_deg: &mut f64,
) {
    if let Some(last) = pieces[first..].last() {
        let turn = turn_deg(last, &piece);
        if meet(last, &piece) && turn < GENTLE_DEG && *turned_deg + turn < MOST_TURN_DEG {
            *turned_deg += turn;
        } else {
            *turned_deg = 0.0;
            *stretch = last.stretch + 1;
        }
    }
    piece.stretch = *stretch;
    pieces.push(piece);
}

fn turn_deg(a: &Piece, b: &Piece) -> f64 {
    let cos = a.normal[0] * b.normal[0] + a.normal[1] * b.normal[1];
    cos.clamp(-1.0, 1.0).acos().to_degrees()
}

/// Whether one piece ends where the other begins, to within a sample.
fn meet(a: &Piece, b: &Piece) -> bool {
    let near = |p: Pair, q: Pair| (p[0] - q[0]).hypot(p[1] - q[1]) < SAMPLE_MM;
    near(a.b, b.a) || near(b.b, a.a)
}

/// Index of the piece that a pixel at a point shows, or [`NO_EDGE`].
fn edge_at(point: Pair, pieces: &[Piece], band_mm: f64, clear_mm: f64) -> u16 {
    let nearest = (0..pieces.len())
        .min_by(|&a, &b| pieces[a].distance_mm(point).total_cmp(&pieces[b].distance_mm(point)));
    let Some(nearest) = nearest else { return NO_EDGE };
    let piece = &pieces[nearest];
    if piece.distance_mm(point) > band_mm {
        return NO_EDGE;
    }
    let goes_on = |other: &Piece| meet(piece, other) && turn_deg(piece, other) < GENTLE_DEG;
    // Beyond the end of an edge is a corner, unless another edge continues it.
    let (s, length) = piece.along(point);
    let has_next = |end: Pair| {
        let near = |p: Pair| (p[0] - end[0]).hypot(p[1] - end[1]) < SAMPLE_MM;
        pieces.iter().enumerate().any(|(index, other)| {
            index != nearest && goes_on(other) && (near(other.a) || near(other.b))
        })
    };
    if (s < 0.0 && !has_next(piece.a)) || (s > length && !has_next(piece.b)) {
        return NO_EDGE;
    }
    let is_clear = |(index, other): (usize, &Piece)| {
        index == nearest
            || other.distance_mm(point) >= clear_mm
            || goes_on(other)
            || (other.stretch == piece.stretch && turn_deg(piece, other) < 2.0 * GENTLE_DEG)
            || piece.is_same_line(other)
    };
    if pieces.iter().enumerate().all(is_clear) { nearest as u16 } else { NO_EDGE }
}

impl Piece {
    /// Position of a point along the edge, and the length of the edge.
    fn along(&self, [x, y]: Pair) -> (f64, f64) {
        let (dx, dy) = (self.b[0] - self.a[0], self.b[1] - self.a[1]);
        let length = dx.hypot(dy).max(1e-9);
        (((x - self.a[0]) * dx + (y - self.a[1]) * dy) / length, length)
    }

    fn distance_mm(&self, [x, y]: Pair) -> f64 {
        let (s, length) = self.along([x, y]);
        let part = (s / length).clamp(0.0, 1.0);
        let near = [0, 1].map(|axis| self.a[axis] + part * (self.b[axis] - self.a[axis]));
        (x - near[0]).hypot(y - near[1])
    }

    /// Whether two pieces lie on one line: two adjacent patches both have their common edge.
    fn is_same_line(&self, other: &Self) -> bool {
        let off = |[x, y]: Pair| {
            (self.normal[0] * (x - self.a[0]) + self.normal[1] * (y - self.a[1])).abs()
        };
        let overlap = |p: Pair| {
            let (s, length) = self.along(p);
            (-BESIDE_MM..=length + BESIDE_MM).contains(&s)
        };
        off(other.a) < BESIDE_MM && off(other.b) < BESIDE_MM && overlap(other.a) && overlap(other.b)
    }
}
