//! Restarted GMRES (Saad and Schultz 1986) on (1 - U (K - J)) H = U E: about half the passes of the fixed point in
//! bright closed rooms, for a basis of `restart` more vectors.

use super::{LightOperator, Progress, SolveError, SolveInfo, Watch};

/// When GMRES stops, and how much it remembers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GmresParams {
    /// Relative residual at which to stop.
    pub tolerance: f64,
    /// Passes at most; beyond that the solve fails.
    pub max_passes: u32,
    /// Vectors of the Krylov basis kept before a restart, at least 1.
    pub restart: u32,
}

/// Vectors that GMRES allocates for a restart length.
pub fn gmres_scratch(restart: u32) -> u32 {
    restart + 2
}

/// Solves to a relative residual ‖U (E + (K - J) H) - H‖ / ‖H‖ in the operator's magnitude, verified by a pass of its
/// own before it is believed.
pub fn gmres<O: LightOperator>(
    operator: &mut O,
    params: &GmresParams,
    progress: &mut Progress,
) -> Result<(O::Vector, SolveInfo), SolveError<O::Error>> {
    gmres_from(operator, None, params, progress)
}

/// The same from a first guess rather than from darkness: each digit of it that is right saves a pass or two.
pub fn gmres_from<O: LightOperator>(
    operator: &mut O,
    guess: Option<O::Vector>,
    params: &GmresParams,
    progress: &mut Progress,
) -> Result<(O::Vector, SolveInfo), SolveError<O::Error>> {
    let mut watch = Watch::new(params.tolerance, params.max_passes, progress);
    let mut started = guess.is_some();
    let mut solution = match guess {
        Some(guess) => guess,
        None => operator.vector()?,
    };
    let mut basis = vec![operator.vector()?];
    let mut radius = Radius::default();
    loop {
        // r = U (E + (K - J) x) - x, in the first basis vector.
        operator.pass(started.then_some(&solution), true, &mut basis[0])?;
        let size = operator.magnitude(&basis[0])?;
        if started {
            operator.combine(-1.0, &solution, 1.0, &mut basis[0])?;
        }
        let magnitude = operator.magnitude(&basis[0])?;
        let residual = if size > 0.0 { magnitude / size } else { magnitude };
        watch.pass(residual)?;
        if watch.converged(residual) {
            return Ok((solution, SolveInfo { spectral_radius: radius.estimate, ..watch.info() }));
        }
        started = true;
        let cycle = Cycle::new(operator, &mut basis, params, residual, &mut watch)?;
        radius.learn(&cycle);
        let coefficients = cycle.coefficients();
        for (y, v) in coefficients.into_iter().zip(&basis) {
            operator.combine(y, v, 1.0, &mut solution)?;
        }
    }
}

/// One Arnoldi cycle: the Hessenberg matrix, made triangular by Givens rotations as it grows.
struct Cycle {
    /// Columns of the Hessenberg matrix itself.
    hessenberg: Vec<Vec<f64>>,
    /// Columns of the triangular factor.
    columns: Vec<Vec<f64>>,
    rotations: Vec<(f64, f64)>,
    /// Right-hand side; its last entry is the norm of the residual.
    rhs: Vec<f64>,
}

impl Cycle {
    /// Runs until the estimated residual falls to half the tolerance, the basis is full, or it spans the solution.
    /// `residual` is the relative residual that the first basis vector, not yet normalised, stands for.
    fn new<O: LightOperator>(
        operator: &mut O,
        basis: &mut Vec<O::Vector>,
        params: &GmresParams,
        residual: f64,
        watch: &mut Watch,
    ) -> Result<Self, SolveError<O::Error>> {
        let beta = operator.dot(&basis[0], &basis[0])?.sqrt();
        operator.scale(1.0 / beta, &mut basis[0])?;
        let mut cycle =
            Self { hessenberg: Vec::new(), columns: Vec::new(), rotations: Vec::new(), rhs: vec![beta] };
        for k in 0..params.restart.max(1) as usize {
            if basis.len() == k + 1 {
                basis.push(operator.vector()?);
            }
            let (known, next) = basis.split_at_mut(k + 1);
            let next = &mut next[0];
            // w = (1 - U (K - J)) v, made orthogonal to the basis (modified Gram-Schmidt).
            operator.pass(Some(&known[k]), false, next)?;
            operator.combine(1.0, &known[k], -1.0, next)?;
            let mut column = Vec::with_capacity(k + 2);
            for v in known.iter() {
                let h = operator.dot(v, next)?;
                operator.combine(-h, v, 1.0, next)?;
                column.push(h);
            }
            let norm = operator.dot(next, next)?.sqrt();
            column.push(norm);
            let estimate = residual * cycle.push(column) / beta;
            watch.pass(estimate)?;
            // Half the tolerance: the estimate is of another norm, and a second cycle costs more than a pass.
            if estimate <= 0.5 * params.tolerance || norm <= f64::EPSILON * beta {
                break;
            }
            operator.scale(1.0 / norm, next)?;
        }
        Ok(cycle)
    }

    /// Adds a column of the Hessenberg matrix; returns the norm of the residual.
    fn push(&mut self, mut column: Vec<f64>) -> f64 {
        let k = self.columns.len();
        self.hessenberg.push(column.clone());
        for (row, &(c, s)) in self.rotations.iter().enumerate() {
            let (a, b) = (column[row], column[row + 1]);
            column[row] = c * a + s * b;
            column[row + 1] = c * b - s * a;
        }
        let r = column[k].hypot(column[k + 1]);
        let (c, s) = if r > 0.0 { (column[k] / r, column[k + 1] / r) } else { (1.0, 0.0) };
        column[k] = r;
        column.truncate(k + 1);
        let last = self.rhs[k];
        self.rhs[k] = c * last;
        self.rhs.push(-s * last);
        self.rotations.push((c, s));
        self.columns.push(column);
        (s * last).abs()
    }

    /// The coefficients of the basis vectors that minimise the residual, by back substitution.
    fn coefficients(&self) -> Vec<f64> {
        let n = self.columns.len();
        let mut y = self.rhs[..n].to_vec();
        for k in (0..n).rev() {
            let pivot = self.columns[k][k];
            y[k] = if pivot != 0.0 { y[k] / pivot } else { 0.0 };
            for row in 0..k {
                y[row] -= self.columns[k][row] * y[k];
            }
        }
        y
    }
}

/// Estimate of the spectral radius of M = U (K - J): the eigenvalues of the Hessenberg matrix of a cycle (Ritz values)
/// approximate the outermost ones of 1 - M.
#[derive(Default)]
struct Radius {
    dimension: usize,
    estimate: Option<f64>,
}

impl Radius {
    /// Believes the longest cycle.
    fn learn(&mut self, cycle: &Cycle) {
        let n = cycle.hessenberg.len();
        if n <= self.dimension || cycle.hessenberg.iter().flatten().any(|h| !h.is_finite()) {
            return;
        }
        self.dimension = n;
        let entry = |row: usize, column: usize| cycle.hessenberg[column].get(row).copied().unwrap_or(0.0);
        let ritz = nalgebra::DMatrix::from_fn(n, n, entry).complex_eigenvalues();
        self.estimate = Some(ritz.iter().map(|z| (1.0 - z.re).hypot(z.im)).fold(0.0, f64::max));
    }
}
