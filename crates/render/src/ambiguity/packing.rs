//! The most of a sum of things that share limited room: maximise c·x where A x ≤ b and x ≥ 0, with b ≥ 0. By the simplex method on a dense
//! table (Dantzig, *Linear Programming and Extensions*, 1963), which starts at x = 0.

/// Entries below this part of the largest one are rounding errors.
const SMALL: f64 = 1e-12;
/// Most steps, in rows and columns. One or two are usual.
const MOST_STEPS: usize = 50;

/// The table: rows of A with b behind them, and the row of c with minus the sum behind it. A step exchanges the unknown of a column, which was
/// zero, for the slack of a row, which becomes zero.
struct Table {
    rows: Vec<Vec<f64>>,
    goal: Vec<f64>,
    /// Names of what belongs to columns and rows.
    columns: Vec<usize>,
    names: Vec<usize>,
}

/// The largest c·x; `None` if it is unbounded, or not found within the steps.
pub(super) fn most(rows: impl Iterator<Item = (Vec<f64>, f64)>, goal: &[f64]) -> Option<f64> {
    let n = goal.len();
    let rows: Vec<Vec<f64>> = rows.map(|(row, room)| [row, vec![room]].concat()).collect();
    let names = (n..n + rows.len()).collect();
    let mut table = Table { rows, goal: [goal, &[0.0]].concat(), columns: (0..n).collect(), names };
    let largest = |of: &[f64]| of.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let small = SMALL * largest(goal);
    let small_entry = SMALL * table.rows.iter().map(|row| largest(&row[..n])).fold(0.0, f64::max);
    // Where a step moves nothing, the lowest names are exchanged, so that steps do not go round (Bland's rule, 1977).
    let mut stuck = false;
    for _ in 0..MOST_STEPS * (n + table.rows.len()) {
        let rising = (0..n).filter(|&j| table.goal[j] > small);
        let column = match stuck {
            true => rising.min_by_key(|&j| table.columns[j]),
            false => rising.max_by(|&i, &j| table.goal[i].total_cmp(&table.goal[j])),
        };
        let Some(column) = column else { return Some(-table.goal[n]) };
        let limits = (0..table.rows.len()).filter(|&i| table.rows[i][column] > small_entry);
        let limit = |i: usize| table.rows[i][n].max(0.0) / table.rows[i][column];
        let row = limits
            .min_by(|&i, &j| limit(i).total_cmp(&limit(j)).then(table.names[i].cmp(&table.names[j])))?;
        stuck = limit(row) == 0.0;
        table.exchange(row, column);
    }
    None
}

impl Table {
    fn exchange(&mut self, row: usize, column: usize) {
        let mut pivot = std::mem::take(&mut self.rows[row]);
        let by = 1.0 / pivot[column];
        pivot.iter_mut().for_each(|x| *x *= by);
        pivot[column] = by;
        for other in self.rows.iter_mut().filter(|row| !row.is_empty()).chain([&mut self.goal]) {
            let factor = other[column];
            if factor != 0.0 {
                other[column] = 0.0;
                other.iter_mut().zip(&pivot).for_each(|(x, p)| *x -= factor * p);
            }
        }
        self.rows[row] = pivot;
        std::mem::swap(&mut self.names[row], &mut self.columns[column]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rows: &[([f64; 2], f64)], goal: [f64; 2]) -> Option<f64> {
        most(rows.iter().map(|(row, room)| (row.to_vec(), *room)), &goal)
    }

    #[test]
    fn corners_are_found() {
        // At (2, 6).
        let rows = [([1.0, 0.0], 4.0), ([0.0, 2.0], 12.0), ([3.0, 2.0], 18.0)];
        assert!(of(&rows, [3.0, 5.0]).is_some_and(|most| (most - 36.0).abs() < 1e-12));
        assert_eq!(of(&rows, [0.0, 0.0]), Some(0.0));
        assert_eq!(of(&rows[..1], [3.0, 5.0]), None);
        // No room for one of both.
        let rows = [([1.0, 1.0], 0.0), ([1.0, 0.0], 0.0), ([0.0, 1.0], 3.0)];
        assert_eq!(of(&rows, [1.0, 1.0]), Some(0.0));
    }

    /// No corner of the cube with cut edges is better: all of them tried.
    #[test]
    fn nothing_is_better() {
        let sides = 6;
        let entry = |i: usize, j: usize| ((7 * i + 3 * j) as f64).sin().abs() + 0.1;
        let rows: Vec<(Vec<f64>, f64)> =
            (0..9).map(|i| ((0..sides).map(|j| entry(i, j)).collect(), 1.0 + (i % 3) as f64)).collect();
        let goal: Vec<f64> = (0..sides).map(|j| entry(20, j)).collect();
        let most = most(rows.iter().cloned(), &goal).expect("a corner");
        let mut best = 0.0f64;
        let mut state = 1u64;
        for _ in 0..20_000 {
            let x: Vec<f64> = (0..sides)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    ((state >> 40) as f64 / (1u64 << 24) as f64).powi(6)
                })
                .collect();
            let dot = |a: &[f64]| a.iter().zip(&x).map(|(a, x)| a * x).sum::<f64>();
            // As far as there is room along x.
            let far = rows.iter().map(|(row, room)| room / dot(row)).fold(f64::INFINITY, f64::min);
            best = best.max(far * dot(&goal));
        }
        assert!(best <= most * (1.0 + 1e-12) && best > 0.97 * most, "{best} of {most}");
    }
}
