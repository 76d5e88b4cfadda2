//! Restarted GMRES (Saad and Schultz 1986) on (1 - U (K - J)) H = U E: about half the passes of the fixed point in
//! bright closed rooms, for a basis of `restart` more vectors.

use super::{
    ConvergenceMonitor, Failed, LightOperator, Next, Orthonormalised, STAGNATION, SolveProgress, Solved, norm,
};
use nalgebra::{DMatrix, DVector, Schur};
use std::ops::AddAssign;

/// Stopping criteria and restart length of GMRES.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct GmresParams {
    /// Relative residual at which to stop.
    pub tolerance: f64,
    /// Largest number of passes; a solve that needs more fails.
    pub max_passes: u32,
    /// Vectors of the Krylov basis kept before a restart, at least 1.
    pub restart: u32,
    /// Fraction of the first residual at which to stop, too; 0 for never.
    pub reduction: f64,
    /// Relative rounding error of a pass. A residual from the basis that can't be wrong by more than a tenth of the
    /// tolerance for that ends the solve without a pass that verifies it. Infinite by default: all are verified.
    pub rounding: f64,
}

impl GmresParams {
    /// Parameters of a solve to a relative residual of `tolerance`, in at most `max_passes` passes, with a
    /// basis of `restart` vectors.
    pub fn new(tolerance: f64, max_passes: u32, restart: u32) -> Self {
        Self { tolerance, max_passes, restart, reduction: 0.0, rounding: f64::INFINITY }
    }

    /// Sets [`GmresParams::reduction`].
    #[must_use]
    pub fn reduction(self, reduction: f64) -> Self {
        Self { reduction, ..self }
    }

    /// Sets [`GmresParams::rounding`].
    #[must_use]
    pub fn rounding(self, rounding: f64) -> Self {
        Self { rounding, ..self }
    }
}

/// Vectors that GMRES allocates for a restart length.
pub fn gmres_scratch(restart: u32) -> u32 {
    restart + 2
}

/// Solves to a relative residual ‖U (E + (K - J) H) - H‖ / ‖H‖ in the operator's magnitude. The basis gives the
/// residual without a pass; one more pass verifies it at the end where rounding may matter.
///
/// # Errors
/// Fails if a pass fails, if the residual diverges, stagnates or is above the tolerance after `max_passes`
/// passes, or if `progress` stops the solve.
pub fn gmres<O: LightOperator + ?Sized>(
    operator: &mut O,
    params: &GmresParams,
    progress: &mut SolveProgress,
) -> Solved<O> {
    gmres_from(operator, None, params, progress)
}

/// Solves like [`gmres`], but from an initial guess rather than from zero: each correct digit saves a pass or
/// two.
///
/// # Errors
/// Fails if a pass fails, if the residual diverges, stagnates or is above the tolerance after `max_passes`
/// passes, or if `progress` stops the solve.
pub fn gmres_from<O: LightOperator + ?Sized>(
    operator: &mut O,
    guess: Option<O::Vector>,
    params: &GmresParams,
    progress: &mut SolveProgress,
) -> Solved<O> {
    let mut monitor =
        ConvergenceMonitor::new(params.tolerance, params.max_passes, params.reduction, progress);
    let mut started = guess.is_some();
    let mut solution = match guess {
        Some(guess) => guess,
        None => operator.vector()?,
    };
    let mut basis = vec![operator.vector()?];
    let mut radius = Radius::default();
    // Verified residual of the previous cycle.
    let mut before = f64::INFINITY;
    loop {
        // r = U (E + (K - J) x) - x, in the first basis vector.
        operator.pass(started.then_some(&solution), true, &mut basis[0])?;
        let judge = Judge::new(operator, &basis[0], started)?;
        if started {
            operator.combine(-1.0, &solution, 1.0, &mut basis[0])?;
        }
        let (size, magnitude) = (judge.size(), operator.magnitude(&basis[0])?);
        let residual = if size > 0.0 { magnitude / size } else { magnitude };
        let stagnates = residual > STAGNATION * before;
        before = residual;
        match monitor.pass(residual)? {
            Next::Converged => return Ok((solution, monitor.info(radius.estimate))),
            // From zero, direct light is the better iterate.
            Next::GiveUp if !started => {
                return Err(monitor.no_convergence(basis.swap_remove(0), radius.estimate));
            }
            Next::Continue if !stagnates => {}
            Next::Continue | Next::GiveUp => return Err(monitor.no_convergence(solution, radius.estimate)),
        }
        started = true;
        let (cycle, y, next) = Cycle::run(operator, &mut basis, params.restart, judge, &mut monitor)?;
        radius.learn(&cycle);
        operator.accumulate(&y, &basis, &mut solution)?;
        match next {
            Next::Converged if params.rounding * cycle.gain() <= MARGIN * monitor.enough() => {
                return Ok((solution, monitor.info(radius.estimate)));
            }
            Next::GiveUp => return Err(monitor.no_convergence(solution, radius.estimate)),
            Next::Converged | Next::Continue => {}
        }
    }
}

/// Largest share of the tolerance that rounding may be for a residual from the basis to count as verified.
const MARGIN: f64 = 0.1;

/// One Arnoldi cycle, from the residual r0 of x0.
struct Cycle {
    /// ‖r0‖, in the norm of the basis.
    beta: f64,
    /// Columns of the Hessenberg matrix.
    hessenberg: Vec<Vec<f64>>,
    judge: Judge,
}

/// Result of a cycle: x = x0 + V y.
struct Found {
    y: Vec<f64>,
    /// ‖r‖ / ‖x + r‖ in the norm of the convergence criterion.
    residual: f64,
}

impl Cycle {
    /// Runs until the residual is within the tolerance, the basis is full, or the solution lies in its span.
    /// The first basis vector is the residual, not yet normalised.
    fn run<O: LightOperator + ?Sized>(
        operator: &mut O,
        basis: &mut Vec<O::Vector>,
        restart: u32,
        judge: Judge,
        monitor: &mut ConvergenceMonitor,
    ) -> Result<(Self, Vec<f64>, Next), Failed<O>> {
        let beta = operator.dot(&basis[0], &basis[0])?.sqrt();
        operator.scale(1.0 / beta, &mut basis[0])?;
        let mut cycle = Self { beta, hessenberg: Vec::new(), judge };
        cycle.judge.add(operator.judged(&basis[0])?);
        loop {
            let k = cycle.hessenberg.len();
            if basis.len() == k + 1 {
                basis.push(operator.vector()?);
            }
            let (known, next) = basis.split_at_mut(k + 1);
            let next = &mut next[0];
            // (1 - U (K - J)) v, made orthogonal to the basis.
            operator.pass(Some(&known[k]), false, next)?;
            let smallest = f64::EPSILON * beta;
            let Orthonormalised { column, judged } = operator.orthonormalise(known, next, smallest)?;
            let spanned = column.last().is_some_and(|norm| *norm <= smallest);
            cycle.hessenberg.push(column);
            cycle.judge.add(judged);
            let found = cycle.found();
            let verdict = monitor.pass(found.residual)?;
            if spanned || k + 1 >= restart.max(1) as usize || verdict != Next::Continue {
                return Ok((cycle, found.y, verdict));
            }
        }
    }

    /// Entry of the Hessenberg matrix, k + 1 by k.
    fn entry(&self, row: usize, column: usize) -> f64 {
        self.hessenberg[column].get(row).copied().unwrap_or(0.0)
    }

    /// Norm of the Hessenberg matrix, a bound of what transport does to a vector of the basis.
    fn gain(&self) -> f64 {
        norm(&self.hessenberg.concat())
    }

    /// Minimises r = V t over y, with t = β e1 - H y.
    fn found(&self) -> Found {
        let k = self.hessenberg.len();
        let hessenberg = DMatrix::from_fn(k + 1, k, |row, column| self.entry(row, column));
        let mut start = DVector::zeros(k + 1);
        start[0] = self.beta;
        let qr = hessenberg.clone().qr();
        let least = qr.r().solve_upper_triangular(&(qr.q().transpose() * &start));
        // `None` where the transport is the identity on a vector: y = 0 then.
        let y = least.unwrap_or_else(|| DVector::zeros(k));
        let t = &start - hessenberg * &y;
        let residual = self.judge.relative(self.beta, &y, &t);
        Found { y: y.as_slice().to_vec(), residual }
    }
}

/// Evaluates the residual of a cycle in the norm of the convergence criterion.
struct Judge {
    /// U (E + (K - J) x0), or its size.
    incident: Judged,
    /// The basis in that norm; empty where `incident` is a size.
    basis: Vec<Vec<f64>>,
    /// Whether x0 is not zero, so that x0 + r0 is not in the basis.
    started: bool,
}

/// The values of a vector that the convergence criterion uses.
enum Judged {
    Part(Vec<f64>),
    /// All of it: the basis is orthonormal, so its coefficients suffice.
    All {
        size: f64,
    },
}

impl Judge {
    fn new<O: LightOperator + ?Sized>(
        operator: &mut O,
        incident: &O::Vector,
        started: bool,
    ) -> Result<Self, O::Error> {
        let incident = match operator.judged(incident)? {
            Some(part) => Judged::Part(part),
            None => Judged::All { size: operator.dot(incident, incident)?.sqrt() },
        };
        Ok(Self { incident, basis: Vec::new(), started })
    }

    fn size(&self) -> f64 {
        match &self.incident {
            Judged::Part(part) => norm(part),
            Judged::All { size } => *size,
        }
    }

    /// Appends what it judges by of the next vector of the basis.
    fn add(&mut self, judged: Option<Vec<f64>>) {
        self.basis.extend(judged);
    }

    /// ‖r‖ / ‖x + r‖ of r = V t and x = x0 + V y.
    fn relative(&self, beta: f64, y: &DVector<f64>, t: &DVector<f64>) -> f64 {
        let mut gain = t.clone();
        gain.rows_mut(0, y.len()).add_assign(y);
        match &self.incident {
            Judged::Part(incident) => {
                // x + r = (x0 + r0) + V (y + t) - r0.
                gain[0] -= beta;
                let r = self.combined(t, vec![0.0; incident.len()]);
                norm(&r) / norm(&self.combined(&gain, incident.clone()))
            }
            Judged::All { size } if self.started => t.norm() / size,
            Judged::All { .. } => t.norm() / gain.norm(),
        }
    }

    fn combined(&self, coefficients: &DVector<f64>, mut sum: Vec<f64>) -> Vec<f64> {
        for (c, v) in coefficients.iter().zip(&self.basis) {
            for (sum, x) in sum.iter_mut().zip(v) {
                *sum += c * x;
            }
        }
        sum
    }
}

/// Largest number of steps of the QR algorithm; a few per eigenvalue are usual.
const RITZ_ITERATIONS: usize = 1000;

/// Estimate of the spectral radius of M = U (K - J): the eigenvalues of the Hessenberg matrix of a cycle (Ritz values)
/// approximate the outermost ones of 1 - M.
#[derive(Default)]
struct Radius {
    dimension: usize,
    estimate: Option<f64>,
}

impl Radius {
    /// Keeps the estimate of the longest cycle.
    fn learn(&mut self, cycle: &Cycle) {
        let n = cycle.hessenberg.len();
        if n <= self.dimension || cycle.hessenberg.iter().flatten().any(|h| !h.is_finite()) {
            return;
        }
        let hessenberg = DMatrix::from_fn(n, n, |row, column| cycle.entry(row, column));
        // Without a bound the iteration does not terminate on some matrices, such as a cyclic shift.
        let Some(schur) = Schur::try_new(hessenberg, f64::EPSILON, RITZ_ITERATIONS) else { return };
        let ritz = schur.complex_eigenvalues();
        self.dimension = n;
        self.estimate = Some(ritz.iter().map(|z| (1.0 - z.re).hypot(z.im)).fold(0.0, f64::max));
    }
}
