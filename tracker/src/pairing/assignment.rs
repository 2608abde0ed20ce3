//! Assignment: the largest set of choices without contradictions, and of equally large sets the cheapest (a
//! maximum independent set of least cost in the graph of contradictions).
//!
//! Choices that contradict each other, directly or through others, form a component. Components are
//! independent and are solved one by one, exactly, by branch and bound:
//!
//! ```text
//! best = greedy solution, cheapest first
//! branch(chosen, open):
//!     stop if |chosen| + groups in open < |best|,
//!             or equal and cost + Σ cheapest of each group ≥ cost of best
//!     take the open group with the fewest choices
//!     for each of its choices: branch with it, less what it contradicts
//!     branch without the group
//! ```
//!
//! A match has components of a few choices each. Noise can make one of hundreds, whose exact solution may
//! take for ever, so a frame has a budget of search steps. When it is spent, the best solution so far is
//! used, which is the greedy one at worst.

/// Most search steps in a frame, a few milliseconds. A crowded match takes some dozens.
const STEPS_PER_FRAME: u32 = 4_000;

/// A choice, with its cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Choice {
    /// At most one choice of a group can be chosen.
    pub group: u64,
    /// Finite.
    pub cost: f64,
}

/// Solves assignments, reusing its tables.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solver {
    /// Bit matrix: the choices that contradict choice i are set in row i.
    conflicts: Vec<u64>,
    /// Choices by cost.
    order: Vec<usize>,
    component: Vec<usize>,
    /// The component's choices in ascending order.
    members: Vec<usize>,
    visited: Vec<bool>,
    search: Search,
}

/// Branch and bound over one component, whose choices are numbered from 0 by cost.
#[derive(Debug, Clone, Default)]
struct Search {
    words: usize,
    conflicts: Vec<u64>,
    /// Group of each choice, numbered from 0 in the order of their cheapest choices.
    groups: Vec<usize>,
    costs: Vec<f64>,
    /// The component's groups in the order of these numbers.
    numbers: Vec<u64>,
    /// Choices still open, one bit set for each depth of the search.
    open: Vec<u64>,
    /// For each group, its number of open choices.
    tally: Vec<u32>,
    /// The groups with open choices, in the order of their cheapest open choices.
    open_groups: Vec<usize>,
    chosen: Vec<usize>,
    best: Vec<usize>,
    best_cost: f64,
    steps_left: u32,
}

impl Solver {
    /// Puts the indices of the chosen into `believed`, in ascending order: no two of one group, none that
    /// contradict each other, as many as possible, and of these sets the one of least total cost. Returns
    /// `false` if the budget was spent and the answer may not be the best.
    pub fn solve(
        &mut self,
        choices: &[Choice],
        contradict: impl Fn(usize, usize) -> bool,
        believed: &mut Vec<usize>,
    ) -> bool {
        believed.clear();
        let count = choices.len();
        let words = count.div_ceil(64);
        self.conflicts.clear();
        self.conflicts.resize(count * words, 0);
        for a in 0..count {
            for b in 0..a {
                if choices[a].group == choices[b].group || contradict(a, b) {
                    self.conflicts[a * words + b / 64] |= 1 << (b % 64);
                    self.conflicts[b * words + a / 64] |= 1 << (a % 64);
                }
            }
        }
        self.order.clear();
        self.order.extend(0..count);
        self.order
            .sort_unstable_by(|&a, &b| choices[a].cost.total_cmp(&choices[b].cost).then(a.cmp(&b)));

        self.search.steps_left = STEPS_PER_FRAME;
        self.visited.clear();
        self.visited.resize(count, false);
        for start in 0..count {
            if self.visited[start] {
                continue;
            }
            self.collect_component(start, words);
            self.search.load(choices, &self.component, &self.conflicts, words);
            self.search.run();
            believed.extend(self.search.best.iter().map(|&local| self.component[local]));
        }
        believed.sort_unstable();
        self.search.steps_left > 0
    }

    /// Fills `component` with all choices that contradict `start` directly or through others, by cost.
    fn collect_component(&mut self, start: usize, words: usize) {
        self.component.clear();
        self.component.push(start);
        self.visited[start] = true;
        let mut next = 0;
        while let Some(&choice) = self.component.get(next) {
            next += 1;
            for other in bits(&self.conflicts[choice * words..(choice + 1) * words]) {
                if !self.visited[other] {
                    self.visited[other] = true;
                    self.component.push(other);
                }
            }
        }
        // Sorts by cost: the order of `order`.
        let mut component = std::mem::take(&mut self.component);
        if component.len() > 1 {
            component.sort_unstable();
            let members = &mut self.members;
            members.clone_from(&component);
            component.clear();
            component.extend(
                self.order.iter().copied().filter(|choice| members.binary_search(choice).is_ok()),
            );
        }
        self.component = component;
    }
}

impl Search {
    fn load(&mut self, choices: &[Choice], component: &[usize], conflicts: &[u64], words: usize) {
        let count = component.len();
        self.words = count.div_ceil(64);
        self.conflicts.clear();
        self.conflicts.resize(count * self.words, 0);
        for (a, &choice) in component.iter().enumerate() {
            let row = &conflicts[choice * words..(choice + 1) * words];
            for (b, &other) in component.iter().enumerate() {
                if row[other / 64] >> (other % 64) & 1 == 1 {
                    self.conflicts[a * self.words + b / 64] |= 1 << (b % 64);
                }
            }
        }
        self.groups.clear();
        self.numbers.clear();
        for &choice in component {
            let group = choices[choice].group;
            let known = self.numbers.iter().position(|&number| number == group);
            self.groups.push(known.unwrap_or(self.numbers.len()));
            if known.is_none() {
                self.numbers.push(group);
            }
        }
        self.tally.clear();
        self.tally.resize(self.numbers.len(), 0);
        self.costs.clear();
        self.costs.extend(component.iter().map(|&choice| choices[choice].cost));
    }

    fn run(&mut self) {
        let count = self.costs.len();
        self.open.clear();
        self.open.resize(self.words, 0);
        for choice in 0..count {
            self.open[choice / 64] |= 1 << (choice % 64);
        }
        self.chosen.clear();
        self.take_greedily();
        if count > 1 {
            self.branch(0, 0.0);
        }
    }

    /// Takes the cheapest choice, then the cheapest that does not contradict it, and so on.
    fn take_greedily(&mut self) {
        self.best.clear();
        for choice in 0..self.costs.len() {
            let row = self.row(choice);
            if !self.best.iter().any(|&other| row[other / 64] >> (other % 64) & 1 == 1) {
                self.best.push(choice);
            }
        }
        self.best_cost = self.best.iter().map(|&choice| self.costs[choice]).sum();
    }

    fn row(&self, choice: usize) -> &[u64] {
        &self.conflicts[choice * self.words..(choice + 1) * self.words]
    }

    /// Tries all extensions of `chosen` by open choices, unless none can beat the best. The depth is bounded
    /// by the number of groups, since each step closes one.
    fn branch(&mut self, depth: usize, cost: f64) {
        if self.steps_left == 0 {
            return;
        }
        self.steps_left -= 1;

        self.open_groups.clear();
        self.tally.fill(0);
        let mut least_cost = 0.0;
        for choice in bits(&self.open[depth * self.words..(depth + 1) * self.words]) {
            let group = self.groups[choice];
            // Choices come by cost: the first of a group is its cheapest.
            if self.tally[group] == 0 {
                self.open_groups.push(group);
                least_cost += self.costs[choice];
            }
            self.tally[group] += 1;
        }
        let most = self.chosen.len() + self.open_groups.len();
        let least_cost = cost + least_cost;
        // The tolerance keeps rounding from sending the search after equal solutions.
        let hopeless = most < self.best.len()
            || (most == self.best.len() && least_cost > self.best_cost - 1e-9);
        if hopeless {
            return;
        }
        // The group with the fewest open choices.
        let fewest = self.open_groups.iter().min_by_key(|&&group| self.tally[group]);
        let Some(&group) = fewest else {
            self.best.clone_from(&self.chosen);
            self.best_cost = cost;
            return;
        };

        let here = depth * self.words;
        let below = here + self.words;
        if self.open.len() < below + self.words {
            self.open.resize(below + self.words, 0);
        }
        for choice in 0..self.groups.len() {
            let is_open = self.open[here + choice / 64] >> (choice % 64) & 1 == 1;
            if self.groups[choice] != group || !is_open {
                continue;
            }
            for word in 0..self.words {
                // Choices of one group contradict each other, so this closes the whole group.
                let mut open = self.open[here + word] & !self.conflicts[choice * self.words + word];
                if word == choice / 64 {
                    open &= !(1 << (choice % 64));
                }
                self.open[below + word] = open;
            }
            self.chosen.push(choice);
            self.branch(depth + 1, cost + self.costs[choice]);
            self.chosen.pop();
        }
        // Without the group.
        for word in 0..self.words {
            self.open[below + word] = self.open[here + word];
        }
        for choice in 0..self.groups.len() {
            if self.groups[choice] == group {
                self.open[below + choice / 64] &= !(1 << (choice % 64));
            }
        }
        self.branch(depth + 1, cost);
    }
}

/// Indices of the bits that are set, in ascending order.
fn bits(words: &[u64]) -> impl Iterator<Item = usize> {
    words.iter().enumerate().flat_map(|(index, &word)| {
        std::iter::successors((word != 0).then_some(word), |&rest| {
            let rest = rest & (rest - 1);
            (rest != 0).then_some(rest)
        })
        .map(move |rest| index * 64 + rest.trailing_zeros() as usize)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn consistent(
        choices: &[Choice],
        contradict: &impl Fn(usize, usize) -> bool,
        set: &[usize],
    ) -> bool {
        set.iter().enumerate().all(|(index, &a)| {
            set[..index]
                .iter()
                .all(|&b| choices[a].group != choices[b].group && !contradict(a.max(b), a.min(b)))
        })
    }

    /// Tries all subsets.
    fn best_by_brute_force(
        choices: &[Choice],
        contradict: &impl Fn(usize, usize) -> bool,
    ) -> (usize, f64) {
        let mut best = (0, 0.0);
        for subset in 0u32..1 << choices.len() {
            let set: Vec<usize> = (0..choices.len()).filter(|i| subset >> i & 1 == 1).collect();
            let cost = set.iter().map(|&i| choices[i].cost).sum();
            if (set.len() > best.0 || (set.len() == best.0 && cost < best.1))
                && consistent(choices, contradict, &set)
            {
                best = (set.len(), cost);
            }
        }
        best
    }

    proptest! {
        #[test]
        fn the_solution_is_the_best_there_is(
            choices in prop::collection::vec((0u64..6, 0.0..10.0f64), 0..12),
            pairs in prop::collection::hash_set((0usize..12, 0usize..12), 0..30),
        ) {
            let choices: Vec<Choice> =
                choices.into_iter().map(|(group, cost)| Choice { group, cost }).collect();
            let contradict = |a: usize, b: usize| pairs.contains(&(a.max(b), a.min(b)));
            let mut solver = Solver::default();
            let mut believed = Vec::new();
            prop_assert!(solver.solve(&choices, contradict, &mut believed));
            prop_assert!(consistent(&choices, &contradict, &believed), "{:?}", believed);
            let (count, cost) = best_by_brute_force(&choices, &contradict);
            prop_assert_eq!(believed.len(), count);
            let got: f64 = believed.iter().map(|&i| choices[i].cost).sum();
            prop_assert!((got - cost).abs() < 1e-6, "{} instead of {}", got, cost);
        }
    }

    #[test]
    fn more_beats_cheaper() {
        // The cheap one stands against both dear ones.
        let choices = [(0, 0.1), (1, 5.0), (2, 5.0)].map(|(group, cost)| Choice { group, cost });
        let mut believed = Vec::new();
        let exact = Solver::default().solve(&choices, |a, b| a.min(b) == 0, &mut believed);
        assert!(exact);
        assert_eq!(believed, [1, 2]);
    }

    #[test]
    fn a_hopeless_tangle_ends_with_something_consistent() {
        // Every choice contradicts those at pseudo-random distances: far too much to search.
        let choices: Vec<Choice> =
            (0..500u64).map(|i| Choice { group: i, cost: (i * 7919 % 101) as f64 }).collect();
        let contradict = |a: usize, b: usize| (a * a + b * b) * 31 % 97 < 9;
        let mut solver = Solver::default();
        let mut believed = Vec::new();
        let exact = solver.solve(&choices, contradict, &mut believed);
        assert!(!exact);
        assert!(believed.len() > 10);
        let symmetric = |a: usize, b: usize| contradict(a.max(b), a.min(b));
        assert!(consistent(&choices, &symmetric, &believed));
        // The next frame has a new budget.
        assert!(solver.solve(&choices[..3], |_, _| false, &mut believed));
        assert_eq!(believed, [0, 1, 2]);
    }
}
