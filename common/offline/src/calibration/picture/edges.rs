//! Edges of a picture, and the distance from any place to the nearest edge of a direction.

use super::brightness::Brightness;
use std::f64::consts::PI;

/// Directions are told apart in so many steps.
const DIRECTIONS: usize = 8;
/// An edge counts for its own direction and for those so many steps beside it.
const BESIDE: usize = 1;
/// Fewest grey levels across an edge.
const LEAST_RISE: f32 = 5.0;
/// The share of the picture that edges may cover: the strongest are kept.
const MOST: f64 = 0.12;
/// Distance to an edge where there is none.
const FAR: f32 = 1e4;

/// For each direction, the distance to the nearest edge, px of a reduced picture.
pub struct EdgeMap {
    /// Factor from pixels of the picture to those of the map.
    pub scale: f64,
    /// Size of the map.
    pub width: usize,
    pub height: usize,
    distances: Vec<Vec<f32>>,
    /// Places of all edges.
    pub edges: Vec<[f64; 2]>,
}

impl EdgeMap {
    /// The edges of a picture, reduced to about this width.
    pub fn of(brightness: &Brightness, width: usize) -> Self {
        let step = (brightness.width / width).max(1);
        let reduced = reduced(brightness, step);
        let (width, height) = (reduced.width, reduced.height);
        let edges = edges(&reduced);
        let mut distances = vec![vec![FAR; width * height]; DIRECTIONS];
        let places = edges.iter().map(|edge| [edge.index % width, edge.index / width]);
        let places = places.map(|place| place.map(|part| part as f64)).collect();
        for edge in edges {
            for beside in 0..=2 * BESIDE {
                let direction = (edge.direction + DIRECTIONS + beside - BESIDE) % DIRECTIONS;
                distances[direction][edge.index] = 0.0;
            }
        }
        distances.iter_mut().for_each(|map| spread(map, width, height));
        Self { scale: 1.0 / step as f64, width, height, distances, edges: places }
    }

    /// Distance from a place of the map to the nearest edge across this normal, at most `most`; `None`
    /// outside the map.
    pub fn distance(&self, [x, y]: [f64; 2], normal: [f64; 2], most: f64) -> Option<f64> {
        let inside = x >= 0.0 && y >= 0.0;
        let (column, row) = (x as usize, y as usize);
        if !inside || column + 1 >= self.width || row + 1 >= self.height {
            return None;
        }
        let map = &self.distances[direction(normal)];
        let at = |column: usize, row: usize| f64::from(map[row * self.width + column]).min(most);
        let (right, down) = (x - column as f64, y - row as f64);
        let above = at(column, row) * (1.0 - right) + at(column + 1, row) * right;
        let below = at(column, row + 1) * (1.0 - right) + at(column + 1, row + 1) * right;
        Some(above * (1.0 - down) + below * down)
    }
}

struct Edge {
    index: usize,
    direction: usize,
}

/// The step of a normal's direction; opposite normals are the same.
fn direction([x, y]: [f64; 2]) -> usize {
    let turns = y.atan2(x).rem_euclid(PI) / PI;
    (turns * DIRECTIONS as f64).round() as usize % DIRECTIONS
}

/// The picture with blocks of pixels averaged.
fn reduced(picture: &Brightness, step: usize) -> Brightness {
    let (width, height) = (picture.width / step, picture.height / step);
    let value = |index: usize| {
        let (column, row) = (index % width * step, index / width * step);
        let mut sum = 0.0;
        for row in row..row + step {
            let begin = row * picture.width + column;
            sum += picture.values[begin..begin + step].iter().sum::<f32>();
        }
        sum / (step * step) as f32
    };
    Brightness { values: (0..width * height).map(value).collect(), width, height }
}

/// Places where brightness changes most, across the change.
fn edges(picture: &Brightness) -> Vec<Edge> {
    let (width, height) = (picture.width, picture.height);
    let value = |column: usize, row: usize| picture.values[row * width + column];
    let mut slopes = vec![[0.0f32; 2]; width * height];
    for row in 1..height.saturating_sub(1) {
        for column in 1..width - 1 {
            // Sobel's operator.
            let column_at = |column: usize| {
                value(column, row - 1) + 2.0 * value(column, row) + value(column, row + 1)
            };
            let row_at = |row: usize| {
                value(column - 1, row) + 2.0 * value(column, row) + value(column + 1, row)
            };
            slopes[row * width + column] = [
                (column_at(column + 1) - column_at(column - 1)) / 4.0,
                (row_at(row + 1) - row_at(row - 1)) / 4.0,
            ];
        }
    }
    let size = |index: usize| slopes[index][0].hypot(slopes[index][1]);
    let mut found: Vec<(f32, Edge)> = Vec::new();
    for row in 2..height.saturating_sub(2) {
        for column in 2..width - 2 {
            let index = row * width + column;
            let here = size(index);
            if here < LEAST_RISE {
                continue;
            }
            let [x, y] = slopes[index].map(|part| part / here);
            let next = |sign: f32| {
                let column = (column as f32 + sign * x).round() as usize;
                let row = (row as f32 + sign * y).round() as usize;
                size(row * width + column)
            };
            if here >= next(1.0) && here > next(-1.0) {
                let direction = direction([f64::from(x), f64::from(y)]);
                found.push((here, Edge { index, direction }));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate((MOST * (width * height) as f64) as usize);
    found.into_iter().map(|(_, edge)| edge).collect()
}

/// Replaces each value by the distance to the nearest 0: two passes with steps of 1 and √2, which is
/// at most 8 % too much.
fn spread(map: &mut [f32], width: usize, height: usize) {
    const DIAGONAL: f32 = std::f32::consts::SQRT_2;
    let relax = |map: &mut [f32], index: usize, from: usize, step: f32| {
        map[index] = map[index].min(map[from] + step);
    };
    for row in 0..height {
        for column in 0..width {
            let index = row * width + column;
            if column > 0 {
                relax(map, index, index - 1, 1.0);
            }
            if row > 0 {
                relax(map, index, index - width, 1.0);
                if column > 0 {
                    relax(map, index, index - width - 1, DIAGONAL);
                }
                if column + 1 < width {
                    relax(map, index, index - width + 1, DIAGONAL);
                }
            }
        }
    }
    for row in (0..height).rev() {
        for column in (0..width).rev() {
            let index = row * width + column;
            if column + 1 < width {
                relax(map, index, index + 1, 1.0);
            }
            if row + 1 < height {
                relax(map, index, index + width, 1.0);
                if column > 0 {
                    relax(map, index, index + width - 1, DIAGONAL);
                }
                if column + 1 < width {
                    relax(map, index, index + width + 1, DIAGONAL);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_is_near_only_across_its_direction() {
        let mut values = vec![20.0; 100 * 80];
        (0..80).for_each(|row| values[row * 100 + 40..row * 100 + 44].fill(200.0));
        let map = EdgeMap::of(&Brightness { values, width: 100, height: 80 }, 100);
        let across = map.distance([30.0, 40.0], [1.0, 0.0], 50.0).unwrap();
        assert!((8.0..=10.5).contains(&across), "{across}");
        assert_eq!(map.distance([30.0, 40.0], [0.0, 1.0], 50.0), Some(50.0));
        assert_eq!(map.distance([-1.0, 40.0], [0.0, 1.0], 50.0), None);
    }
}
