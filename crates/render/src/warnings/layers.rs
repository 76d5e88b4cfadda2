//! Stacked layers, whose gains multiply.

use super::gain::{Gain, Gains};

/// Longest chain that is followed; longer ones count as endless.
const LONGEST: usize = 64;

/// The worst chain of layers in front of a triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Product of the gains.
    pub gain: f64,
    /// The blockers, from the first that light meets, and the triangle that they shadow.
    pub triangles: Vec<u32>,
    /// More than [`LONGEST`] layers, or a cycle of blockers each behind the other.
    pub endless: bool,
}

/// For each triangle, the largest product of gains above 1 along a chain of blockers that ends there.
pub struct Layers {
    /// 1 where there is no chain.
    product: Vec<f64>,
    /// The last link of the chain.
    last: Vec<Option<Gain>>,
    endless: bool,
}

impl Layers {
    /// Relaxes G_j = max over i of gain_ij max(1, G_i) until nothing grows.
    pub fn of(gains: &Gains) -> Self {
        let count = gains.strongest.len();
        let mut layers = Self { product: vec![1.0; count], last: vec![None; count], endless: false };
        for round in 0..=LONGEST {
            let before = layers.product.clone();
            let mut grew = false;
            for (receiver, strongest) in gains.strongest.iter().enumerate() {
                for link in strongest.iter().filter(|link| link.gain > 1.0) {
                    let product = link.gain * before[link.blocker as usize];
                    if product > layers.product[receiver] * (1.0 + 1e-9) {
                        layers.product[receiver] = product;
                        layers.last[receiver] = Some(*link);
                        grew = true;
                    }
                }
            }
            if !grew {
                break;
            }
            layers.endless = round == LONGEST;
        }
        layers
    }

    /// Triangles behind at least two layers, the worst first.
    pub fn stacked(&self) -> Vec<u32> {
        let stacked =
            |&i: &u32| self.last[i as usize].is_some_and(|link| self.last[link.blocker as usize].is_some());
        let mut all: Vec<u32> = (0..self.last.len() as u32).filter(stacked).collect();
        all.sort_by(|&a, &b| self.product[b as usize].total_cmp(&self.product[a as usize]));
        all
    }

    pub fn product(&self, triangle: u32) -> f64 {
        self.product[triangle as usize]
    }

    /// The chain that ends at a triangle.
    pub fn chain(&self, triangle: u32) -> Chain {
        let mut triangles = vec![triangle];
        while let Some(link) = self.last[triangles[triangles.len() - 1] as usize] {
            if triangles.contains(&link.blocker) || triangles.len() > LONGEST {
                break;
            }
            triangles.push(link.blocker);
        }
        triangles.reverse();
        Chain { gain: self.product(triangle), triangles, endless: self.endless }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gains(count: usize, links: &[(u32, u32, f64)]) -> Gains {
        let mut gains = Gains { strongest: vec![Vec::new(); count], of_blocker: vec![None; count] };
        for &(blocker, receiver, gain) in links {
            gains.strongest[receiver as usize].push(Gain { blocker, receiver, gain });
        }
        gains
    }

    #[test]
    fn gains_multiply_along_the_worst_chain() {
        let layers =
            Layers::of(&gains(5, &[(0, 1, 3.0), (1, 2, 4.0), (0, 2, 5.0), (2, 3, 0.5), (2, 4, 2.0)]));
        assert_eq!(layers.stacked(), [4, 2]);
        let chain = layers.chain(4);
        assert_eq!((chain.gain, chain.triangles, chain.endless), (24.0, vec![0, 1, 2, 4], false));
        assert_eq!(layers.product(3), 1.0, "a gain below 1 is no link");
    }

    #[test]
    fn cycles_end() {
        let layers = Layers::of(&gains(3, &[(0, 1, 2.0), (1, 0, 2.0), (1, 2, 2.0)]));
        let chain = layers.chain(2);
        assert!(chain.endless && chain.gain > 1e12 && chain.triangles == [0, 1, 2], "{chain:?}");
    }
}
