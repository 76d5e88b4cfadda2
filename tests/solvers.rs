//! Guarantees of the solvers, on the f64 reference and on artificial operators.

mod support;

use antirad_core::solve::{
    FixedPointParams, GmresParams, LightOperator, SolveError, fixed_point, gmres, gmres_from, gmres_scratch,
};
use antirad_reference::{Model, State};
use std::convert::Infallible;
use std::ops::ControlFlow;
use support::random::random_scene;

fn go_on(_: u32, _: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// ‖U (E + (K - J) x) - x‖ over ‖U (E + (K - J) x)‖.
fn residual(model: &Model, x: &State) -> f64 {
    let mut operator = model;
    let mut y = model.zero();
    let Ok(()) = operator.pass(Some(x), true, &mut y);
    let Ok(size) = operator.magnitude(&y);
    let Ok(()) = operator.combine(-1.0, x, 1.0, &mut y);
    let Ok(difference) = operator.magnitude(&y);
    difference / size
}

/// The reported residual is that of the result, and once the basis reaches the tolerance one pass verifies it.
#[test]
fn gmres_ends_with_the_residual_it_reports_and_one_pass_after_reaching_it() {
    for (seed, glossy) in [(1, false), (2, true), (3, true)] {
        let model = Model::new(&random_scene(seed, 120, glossy, false));
        for tolerance in [1e-3, 1e-4, 1e-8] {
            for restart in [4, 16] {
                let params = GmresParams::new(tolerance, 400, restart);
                let (x, info) = gmres(&mut &model, &params, &mut go_on).expect("a solution");
                let told = *info.residuals.last().expect("a residual");
                let true_one = residual(&model, &x);
                let within = info.residuals.iter().filter(|r| **r <= tolerance).count();
                println!("{seed}, {tolerance:e}, restart {restart}: {} passes, {true_one:.2e}", info.passes);
                assert!(info.converged && true_one <= tolerance, "{true_one:e} {tolerance:e}");
                assert!((told / true_one - 1.0).abs() <= 1e-6, "{told:e} told, {true_one:e}");
                assert_eq!(within, 2, "reached in the basis and verified: {:?}", info.residuals);
            }
        }
    }
}

/// Out of passes: the returned iterate has the reported residual, and a later solve can start from it.
#[test]
fn without_convergence_the_best_iterate_is_returned() {
    let model = Model::new(&random_scene(2, 120, true, false));
    for max_passes in [1, 2, 3, 4, 5] {
        let params = GmresParams::new(1e-12, max_passes, 3);
        let Err(SolveError::NoConvergence { residual: told, best, passes, stagnated, residuals, .. }) =
            gmres(&mut &model, &params, &mut go_on)
        else {
            panic!("1e-12 after {max_passes} passes");
        };
        assert_eq!((passes, stagnated, residuals.len()), (max_passes, false, max_passes as usize));
        let reached = residual(&model, &best);
        println!("{max_passes} passes: {told:.3e} told, {reached:.3e}");
        // After the first pass the iterate is direct light, one bounce better than the zero state of the residual.
        assert!(max_passes == 1 || (reached / told - 1.0).abs() <= 1e-6, "{told:e} told, {reached:e}");
        assert!(reached < 1.0, "{reached}");

        let params = GmresParams::new(params.tolerance, 400, 16);
        let (_, from_there) = gmres_from(&mut &model, Some(best), &params, &mut go_on).expect("a solution");
        assert!(from_there.residuals[0] <= reached * (1.0 + 1e-6), "{from_there:?}");
    }
    let params = FixedPointParams::new(1e-10, 4);
    match fixed_point(&mut &model, &params, &mut go_on) {
        Err(SolveError::NoConvergence { residual: told, best, .. }) => {
            let reached = residual(&model, &best);
            assert!(reached <= told, "the iterate is a bounce better: {told:e} told, {reached:e}");
        }
        other => panic!("{:?}", other.map(|(_, info)| info)),
    }
}

/// x -> shifted x: GMRES gains nothing from it until the basis spans the whole space.
struct Shift(usize);

impl LightOperator for Shift {
    type Vector = Vec<f64>;
    type Error = Infallible;

    fn vector(&mut self) -> Result<Vec<f64>, Infallible> {
        Ok(vec![0.0; self.0])
    }

    /// 1 - M is the shift.
    fn pass(&mut self, x: Option<&Vec<f64>>, emission: bool, y: &mut Vec<f64>) -> Result<(), Infallible> {
        let n = self.0;
        for i in 0..n {
            let emitted = if emission && i == 0 { 1.0 } else { 0.0 };
            y[i] = emitted + x.map_or(0.0, |x| x[i] - x[(i + n - 1) % n]);
        }
        Ok(())
    }

    fn dot(&mut self, x: &Vec<f64>, y: &Vec<f64>) -> Result<f64, Infallible> {
        Ok(x.iter().zip(y).map(|(a, b)| a * b).sum())
    }

    fn combine(&mut self, a: f64, x: &Vec<f64>, b: f64, y: &mut Vec<f64>) -> Result<(), Infallible> {
        x.iter().zip(y).for_each(|(x, y)| *y = a * x + b * *y);
        Ok(())
    }

    fn scale(&mut self, b: f64, y: &mut Vec<f64>) -> Result<(), Infallible> {
        y.iter_mut().for_each(|y| *y *= b);
        Ok(())
    }

    fn judged(&mut self, x: &Vec<f64>) -> Result<Option<Vec<f64>>, Infallible> {
        Ok(Some(x.clone()))
    }
}

/// A cycle that gains nothing ends the solve.
#[test]
fn stagnation_is_reported_as_soon_as_a_cycle_gains_nothing() {
    let params = |restart| GmresParams::new(1e-6, 1000, restart);
    let (x, info) = gmres(&mut Shift(12), &params(12), &mut go_on).expect("the basis spans the space");
    assert!((x[11] - 1.0).abs() <= 1e-12 && info.passes == 14, "{x:?} {info:?}");
    match gmres(&mut Shift(12), &params(5), &mut go_on) {
        Err(error @ SolveError::NoConvergence { stagnated: true, passes: 7, .. }) => {
            assert!(error.to_string().contains("more passes would not help"), "{error}");
        }
        other => panic!("{:?}", other.map(|(_, info)| info)),
    }
}

/// The planner counts the vectors that the solver allocates, without depending on it.
#[test]
fn plans_count_the_vectors_of_gmres() {
    use antirad_core::plan::PlannedSolver;
    for restart in [1, 4, 16] {
        assert_eq!(PlannedSolver::Gmres { restart }.vectors(), gmres_scratch(restart));
    }
}
