//! Rows of some receivers, which grow with their rays.

use super::seen::{Found, Moments, Seen};
use crate::plan::Row;
use std::f64::consts::PI;

/// Receivers of a chunk: few enough that what a thread has in hand is small.
pub const RECEIVERS: usize = 64;

/// Rows of consecutive receivers, as sums of the weights of their rays.
#[derive(Default)]
pub struct Chunk {
    pub receivers: Vec<Receiver>,
    /// Those of each receiver in ascending order of block and index, each with its entries in ascending order of columns.
    pub rows: Vec<Row>,
    columns: Vec<u32>,
    weights: Vec<f32>,
}

/// A receiver, and the rays that left it.
#[derive(Clone, Copy, Default)]
pub struct Receiver {
    pub slot: u32,
    pub rays: u32,
    /// Sums of the weights of rays, and of their squares.
    all: f64,
    squares: f64,
    moments: [Moments; 2],
    /// Rays of the last look, and what one of each quarter of them brought on average.
    last: u32,
    quarters: [f64; 4],
    /// First of its rows, and their number.
    first: u32,
    count: u32,
}

/// What the rays of a receiver bring.
#[derive(Clone, Copy, Debug, Default)]
pub struct Brought {
    /// Irradiance.
    pub irradiance: f64,
    /// Variance of what one ray brings, where all have equal weight.
    pub variance: f64,
    /// How many rays of equal weight tell as much as one.
    pub effective: f64,
    /// Rays of the last look.
    pub last: f64,
    /// Squares of half the difference of the halves of these, and of the quarters of the halves on average.
    pub halves: f64,
    pub quarters: f64,
}

impl Chunk {
    /// Receivers that no ray has left.
    pub fn new(slots: &[u32]) -> Self {
        let receiver = |&slot: &u32| Receiver { slot, ..Receiver::default() };
        Self { receivers: slots.iter().map(receiver).collect(), ..Self::default() }
    }

    /// The same with as many rays of each receiver as wanted. `radiance`: of slots, for what rays bring.
    pub fn extended(self, seen: &Seen, wanted: impl Fn(u32) -> u32, radiance: &[f64]) -> Self {
        if self.receivers.iter().all(|receiver| wanted(receiver.slot) <= receiver.rays) {
            return self;
        }
        let mut longer = Self::default();
        let mut sums = seen.sums();
        for receiver in &self.receivers {
            let rays = wanted(receiver.slot).max(receiver.rays);
            if rays == receiver.rays {
                longer.add(&self, *receiver, &Found::default());
                continue;
            }
            let found = seen.look(&mut sums, receiver.slot, receiver.rays..rays, radiance);
            let last = rays - receiver.rays;
            longer.add(&self, Receiver { rays, last, quarters: found.quarters, ..*receiver }, &found);
        }
        longer.rows.shrink_to_fit();
        longer.columns.shrink_to_fit();
        longer.weights.shrink_to_fit();
        longer
    }

    /// Appends a receiver: its rows in an earlier chunk, and what more rays have found.
    fn add(&mut self, before: &Self, receiver: Receiver, found: &Found) {
        let first = self.rows.len() as u32;
        let mut old = before.rows_of(&receiver).iter().peekable();
        let mut new = found.rows.rows.iter().peekable();
        let key = |row: &&Row| (row.block, row.index);
        while let Some((block, index)) = old.peek().map(key).into_iter().chain(new.peek().map(key)).min() {
            let start = self.columns.len() as u32;
            let is_next = |row: &&Row| key(row) == (block, index);
            let entries = old.next_if(is_next).into_iter().flat_map(|row| before.entries(row));
            let more = new.next_if(is_next).into_iter().flat_map(|row| found.rows.entries(row));
            self.merge(entries, more.map(|(column, weight)| (column, weight as f32)));
            self.rows.push(Row { block, index, first: start, length: self.columns.len() as u32 - start });
        }
        let mut moments = receiver.moments;
        moments.iter_mut().zip(found.moments).for_each(|(to, by)| *to += by);
        let (all, squares) = (receiver.all + found.all, receiver.squares + found.squares);
        let count = self.rows.len() as u32 - first;
        self.receivers.push(Receiver { all, squares, moments, first, count, ..receiver });
    }

    /// Appends the sum of two lists of entries.
    fn merge(&mut self, some: impl Iterator<Item = (u32, f32)>, more: impl Iterator<Item = (u32, f32)>) {
        let (mut some, mut more) = (some.peekable(), more.peekable());
        while let Some(column) = some.peek().into_iter().chain(more.peek()).map(|entry| entry.0).min() {
            let own = [some.next_if(|entry| entry.0 == column), more.next_if(|entry| entry.0 == column)];
            self.columns.push(column);
            self.weights.push(own.into_iter().flatten().map(|(_, weight)| weight).sum());
        }
    }

    pub fn rows_of(&self, receiver: &Receiver) -> &[Row] {
        &self.rows[receiver.first as usize..][..receiver.count as usize]
    }

    /// Columns and sums of weights of a row.
    pub fn entries<'a>(&'a self, row: &Row) -> impl Iterator<Item = (u32, f32)> + use<'a> {
        let entries = row.first as usize..(row.first + row.length) as usize;
        self.columns[entries.clone()].iter().copied().zip(self.weights[entries].iter().copied())
    }

    /// What the rays of each receiver bring of the radiance of slots.
    pub fn brought<'a>(&'a self, radiance: &'a [f64]) -> impl Iterator<Item = (&'a Receiver, Brought)> {
        self.receivers.iter().map(|receiver| {
            let diffuse = self.rows_of(receiver).iter().take_while(|row| row.block == 0);
            let (mut sum, mut squares) = (0.0, 0.0);
            for (column, weight) in diffuse.flat_map(|row| self.entries(row)) {
                let light = f64::from(weight) * radiance[column as usize];
                sum += light;
                squares += light * radiance[column as usize];
            }
            let per_ray = PI / receiver.all.max(f64::MIN_POSITIVE);
            let irradiance = per_ray * sum;
            let (variance, effective) = match receiver.aimed() {
                None => {
                    let variance = (PI * per_ray * squares - irradiance * irradiance).max(0.0);
                    (variance, receiver.effective() / f64::from(receiver.rays.max(1)))
                }
                Some(deviations) => (per_ray * per_ray * f64::from(receiver.rays) * deviations, 1.0),
            };
            let [a, b, c, d] = receiver.quarters;
            let square = |difference: f64| (PI * difference).powi(2);
            let halves = square((a + b - c - d) / 4.0);
            let quarters = 0.5 * (square((a - b) / 2.0) + square((c - d) / 2.0));
            let last = f64::from(receiver.last);
            (receiver, Brought { irradiance, variance, effective, last, halves, quarters })
        })
    }
}

impl Receiver {
    /// What a sum of the weights of its rays counts, sr.
    pub fn per_ray(&self) -> f64 {
        PI / self.all
    }

    /// Sum of the squares of what rays deviate from the mean of their kind, where some are aimed.
    fn aimed(&self) -> Option<f64> {
        (self.moments[1].rays > 0).then(|| self.moments.iter().map(Moments::deviations).sum())
    }

    /// How many rays of equal weight tell as much.
    fn effective(&self) -> f64 {
        self.all * self.all / self.squares
    }
}
