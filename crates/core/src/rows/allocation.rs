//! How many rays leave each triangle.
//!
//! The variance of what a ray brings is that of the radiance that the row of its triangle sees, so that few rays tell it. Of n rays of a
//! receiver of area a, which bring σ of standard deviation each, the error is about σ n^(-1/2); so n ∝ (a σ)^(2/3) leaves the least mean
//! error over the area for a number of rays. In dark places errors count relative to the light there.

use antirad_base::parallel;

/// Rays of a triangle at least, and the unit of their numbers: a power of two, by which Sobol' points are evenly spread.
pub const FEWEST: u32 = 64;
/// Rays of a triangle at most.
pub const MOST: u32 = 1 << 16;
/// So many times as many rays as before leave a triangle at most, before its variance is looked at again.
const GROWTH: u32 = 8;
/// Rays in multiples of those before that are worth another look.
const WORTH: f64 = 1.25;
/// Irradiance relative to its mean below which places count as dark.
const DARK: f64 = 1e-3;
/// The mean error relative to the irradiance of each place may be so many times as large as that relative to mean irradiance: where much of
/// the area is dark, or an outer wall in the sun, the latter says little.
const AT_PLACES: f64 = 4.0;
/// Share of the mean area to which small triangles count as large.
const SMALL: f64 = 1.0 / 16.0;
/// Halvings of the interval of factors that are looked at: more digits than numbers of rays have.
const STEPS: u32 = 40;

/// A receiver, as some rays tell it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
    pub area: f64,
    /// Of all light.
    pub irradiance: f64,
    /// Standard error by the rays so far.
    pub error: f64,
    /// Rays so far.
    pub rays: u32,
    /// The power of the number of rays by which the error falls.
    pub falls: f64,
}

impl Known {
    /// Standard error of irradiance by so many rays.
    fn error(&self, rays: f64) -> f64 {
        if self.error > 0.0 { self.error * (f64::from(self.rays) / rays).powf(self.falls) } else { 0.0 }
    }
}

/// Means over the area of standard errors: relative to mean irradiance, and to that of each place.
pub fn mean_errors(receivers: &[Known], rays: impl Fn(usize) -> f64) -> [f64; 2] {
    let mean = mean_irradiance(receivers);
    let [mut area, mut of_all, mut of_places] = [0.0; 3];
    for (i, of) in receivers.iter().enumerate().filter(|(_, of)| of.area > 0.0) {
        let error = of.area * of.error(rays(i));
        area += of.area;
        of_all += error;
        of_places += error / of.irradiance.max(DARK * mean).max(f64::MIN_POSITIVE);
    }
    if mean > 0.0 { [of_all / mean / area, of_places / area] } else { [0.0; 2] }
}

/// Mean over the area.
pub fn mean_irradiance(receivers: &[Known]) -> f64 {
    let [mut area, mut sum] = [0.0; 2];
    for of in receivers {
        area += of.area;
        sum += of.area * of.irradiance;
    }
    if area > 0.0 { sum / area } else { 0.0 }
}

/// Numbers of rays for a mean standard error of irradiance relative to its mean, `most` in all: no fewer than there are.
pub fn rays(receivers: &[Known], wanted: f64, most: u64) -> Vec<u32> {
    let (area, mean) = (receivers.iter().map(|of| of.area).sum::<f64>(), mean_irradiance(receivers));
    let lit = receivers.iter().filter(|of| of.area > 0.0).count().max(1);
    let least_area = SMALL * area / lit as f64;
    let weight = |of: &Known| {
        let deviation = of.error * f64::from(of.rays).sqrt();
        let relative = deviation / of.irradiance.max(DARK * mean).max(f64::MIN_POSITIVE);
        if of.area > 0.0 { (of.area.max(least_area) * relative).powf(2.0 / 3.0) } else { 0.0 }
    };
    let weights = parallel::map(receivers, weight);
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return receivers.iter().map(|of| of.rays).collect();
    }
    let count = |i: usize, factor: f64| {
        if weights[i] == 0.0 {
            return receivers[i].rays;
        }
        let wanted = (factor * weights[i] / largest).clamp(f64::from(FEWEST), f64::from(MOST));
        (wanted as u32).next_multiple_of(FEWEST)
    };
    let rays = |i: usize, factor: f64| count(i, factor).max(receivers[i].rays);
    let all = |factor: f64| (0..receivers.len()).map(|i| u64::from(rays(i, factor))).sum::<u64>();
    // Not so many that there are too many, and else enough.
    let enough = |factor: f64| {
        let small = || {
            let [of_all, of_places] = mean_errors(receivers, |i| f64::from(rays(i, factor)));
            of_all <= wanted && of_places <= AT_PLACES * wanted
        };
        all(factor) > most || small()
    };
    let (mut few, mut many) = (0.0, f64::from(MOST) * 16.0);
    for _ in 0..STEPS {
        let middle = 0.5 * (few + many);
        if enough(middle) { many = middle } else { few = middle }
    }
    let factor = if all(many) > most { few } else { many };
    let grown = |(i, of): (usize, &Known)| {
        let wanted = count(i, factor);
        let is_worth = f64::from(wanted) >= WORTH * f64::from(of.rays);
        if is_worth { wanted.min(GROWTH * of.rays) } else { of.rays }
    };
    receivers.iter().enumerate().map(grown).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(area: f64, irradiance: f64, deviation: f64) -> Known {
        Known { area, irradiance, error: deviation / f64::from(FEWEST).sqrt(), rays: FEWEST, falls: 0.5 }
    }

    #[test]
    fn rays_go_where_light_varies() {
        let receivers =
            [known(1.0, 1.0, 0.0), known(1.0, 1.0, 0.5), known(1.0, 1.0, 4.0), known(0.0, 0.0, 0.0)];
        let found = rays(&receivers, 0.01, 1 << 30);
        assert_eq!((found[0], found[3]), (FEWEST, FEWEST));
        assert!(found[1] > FEWEST && found[1] <= found[2] && found[2] == GROWTH * FEWEST, "{found:?}");
        assert_eq!(rays(&receivers, 1.0, 1 << 30), [FEWEST; 4]);
        // With a bound on their number there are as many as it allows.
        let bounded = rays(&receivers, 1e-9, 1200);
        assert!((700..=1200).contains(&bounded.iter().sum::<u32>()), "{bounded:?}");
    }

    #[test]
    fn rays_are_as_many_as_the_error_asks_for() {
        let mut receivers: Vec<Known> = (0..100).map(|i| known(1.0, 1.0, 0.02 * f64::from(i))).collect();
        for _ in 0..4 {
            let found = rays(&receivers, 0.02, 1 << 30);
            for (of, rays) in receivers.iter_mut().zip(found) {
                *of = Known { error: of.error(f64::from(rays)), rays, ..*of };
            }
        }
        let [error, _] = mean_errors(&receivers, |i| f64::from(receivers[i].rays));
        assert!((0.015..=0.021).contains(&error), "{error}");
    }
}
