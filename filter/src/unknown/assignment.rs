//! The linear assignment problem: each row takes one of the columns or none, each column goes to one row at
//! most, and the total cost is minimal.
//!
//! It is solved exactly in polynomial time by shortest augmenting paths (Kuhn's Hungarian method in the form
//! of Jonker and Volgenant, 1987). Dual variables are kept for rows and columns, such that no pair costs less
//! than the sum of its two and a matched pair costs exactly that. Each new row is assigned along the cheapest
//! alternating path in reduced costs, by Dijkstra's algorithm. The tracker's assignment, in contrast,
//! searches among explanations that contradict each other in arbitrary ways.

/// Solver that reuses its tables.
#[derive(Debug, Clone, Default)]
pub(super) struct Assignment {
    /// Number of columns that can be taken. Behind them, each row has a column of its own for taking none.
    columns: usize,
    /// Cost of each row and column, below 0 to be worth taking; infinite where impossible.
    costs: Vec<f64>,
    /// Dual variables: no pair costs less than the sum of its two, and a matched pair costs exactly that.
    row_duals: Vec<f64>,
    column_duals: Vec<f64>,
    /// For each column, the row that has it.
    owners: Vec<Option<usize>>,
    /// For the search of one row, by column: length of the shortest path to it, the column before it on that
    /// path, and whether it has been visited.
    distances: Vec<f64>,
    origins: Vec<Option<usize>>,
    visited: Vec<bool>,
}

impl Assignment {
    /// A problem with these numbers of rows and columns, in which no row can take anything yet.
    pub fn start(&mut self, rows: usize, columns: usize) {
        self.columns = columns;
        self.costs.clear();
        self.costs.resize(rows * columns, f64::INFINITY);
        self.row_duals.clear();
        self.row_duals.resize(rows, 0.0);
        self.column_duals.clear();
        self.column_duals.resize(columns + rows, 0.0);
        self.owners.clear();
        self.owners.resize(columns + rows, None);
    }

    /// Sets the cost of a row taking a column; taking none costs 0.
    pub fn set(&mut self, row: usize, column: usize, cost: f64) {
        self.costs[row * self.columns + column] = cost;
    }

    /// The row that gets a column, after [`solve`](Self::solve).
    pub fn owner(&self, column: usize) -> Option<usize> {
        self.owners[column]
    }

    /// Finds the assignment of minimal total cost.
    pub fn solve(&mut self) {
        for row in 0..self.row_duals.len() {
            self.augment(row);
        }
    }

    fn cost(&self, row: usize, column: usize) -> f64 {
        match column.checked_sub(self.columns) {
            None => self.costs[row * self.columns + column],
            Some(own) if own == row => 0.0,
            Some(_) => f64::INFINITY,
        }
    }

    /// Finds the cheapest way to give `new` a column, moving others to further ones if needed. There always
    /// is one, since its own is free.
    fn augment(&mut self, new: usize) {
        let all = self.owners.len();
        self.distances.clear();
        self.distances.resize(all, f64::INFINITY);
        self.origins.clear();
        self.origins.resize(all, None);
        self.visited.clear();
        self.visited.resize(all, false);
        let (mut row, mut from) = (new, None);
        let free = loop {
            let mut nearest: Option<(usize, f64)> = None;
            for column in 0..all {
                if self.visited[column] {
                    continue;
                }
                let further =
                    self.cost(row, column) - self.row_duals[row] - self.column_duals[column];
                if further < self.distances[column] {
                    self.distances[column] = further;
                    self.origins[column] = from;
                }
                if nearest.is_none_or(|(_, distance)| self.distances[column] < distance) {
                    nearest = Some((column, self.distances[column]));
                }
            }
            let Some((column, step)) = nearest.filter(|(_, distance)| distance.is_finite()) else {
                return;
            };
            // Dual variables of visited rows and columns change by the step, so that distances count from
            // here.
            self.row_duals[new] += step;
            for other in 0..all {
                if !self.visited[other] {
                    self.distances[other] -= step;
                } else if let Some(owner) = self.owners[other] {
                    self.row_duals[owner] += step;
                    self.column_duals[other] -= step;
                }
            }
            self.visited[column] = true;
            match self.owners[column] {
                None => break column,
                Some(owner) => (row, from) = (owner, Some(column)),
            }
        };
        let mut column = free;
        while let Some(origin) = self.origins[column] {
            self.owners[column] = self.owners[origin];
            column = origin;
        }
        self.owners[column] = Some(new);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn solved(costs: &[Vec<f64>], columns: usize) -> Assignment {
        let mut assignment = Assignment::default();
        // The state of an earlier problem has no effect.
        assignment.start(3, 7);
        assignment.set(2, 6, -5.0);
        assignment.solve();
        assignment.start(costs.len(), columns);
        for (row, costs) in costs.iter().enumerate() {
            costs.iter().enumerate().for_each(|(column, &cost)| assignment.set(row, column, cost));
        }
        assignment.solve();
        assignment
    }

    /// The minimal total cost of the rows from `row` on.
    fn by_brute_force(costs: &[Vec<f64>], row: usize, taken: &mut Vec<bool>) -> f64 {
        let Some(own) = costs.get(row) else { return 0.0 };
        let mut least = by_brute_force(costs, row + 1, taken);
        for (column, cost) in own.iter().enumerate() {
            if !taken[column] && cost.is_finite() {
                taken[column] = true;
                least = least.min(cost + by_brute_force(costs, row + 1, taken));
                taken[column] = false;
            }
        }
        least
    }

    proptest! {
        #[test]
        fn the_solution_is_optimal(
            rows in 0usize..6,
            columns in 0usize..6,
            costs in prop::collection::vec((-40.0..10.0f64, 0.0..1.0f64), 36),
        ) {
            let cost = |(cost, possible): (f64, f64)| {
                if possible < 0.7 { cost } else { f64::INFINITY }
            };
            let costs: Vec<Vec<f64>> = (0..rows)
                .map(|row| (0..columns).map(|column| cost(costs[row * 6 + column])).collect())
                .collect();
            let assignment = solved(&costs, columns);
            let mut total = 0.0;
            let mut rows_with_one = vec![];
            for (row, column) in (0..columns).filter_map(|it| Some((assignment.owner(it)?, it))) {
                total += costs[row][column];
                rows_with_one.push(row);
            }
            rows_with_one.sort_unstable();
            prop_assert!(rows_with_one.windows(2).all(|pair| pair[0] != pair[1]));
            let least = by_brute_force(&costs, 0, &mut vec![false; columns]);
            prop_assert!((total - least).abs() < 1e-9, "{} instead of {}", total, least);
        }
    }
}
