//! Work of the host that ranks compute in shares.

use super::{RankError, Ranks};
use crate::parallel;
use serde::{Serialize, de::DeserializeOwned};

impl Ranks {
    /// The results of `of` for all numbers below `count`, in order. Each rank computes its share on all
    /// cores, and sends it to all others; `init` makes the scratch space of a core. All ranks call it.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    #[doc(hidden)]
    pub fn map_init<S, T>(
        &self,
        count: usize,
        init: impl Fn() -> S + Send + Sync,
        of: impl Fn(&mut S, usize) -> T + Send + Sync,
    ) -> Result<Vec<T>, RankError>
    where
        T: Serialize + DeserializeOwned + Send,
    {
        let own = parallel::map_init(self.own(count), init, of);
        self.merged(count, own)
    }

    /// Those of the numbers below `count` that this rank computes, ascending.
    #[doc(hidden)]
    pub fn own(&self, count: usize) -> Vec<usize> {
        (0..count).filter(|&number| self.computes(number) == self.rank()).collect()
    }

    /// The results for all numbers below `count`, in order, where `own` are those for [`own`](Self::own). All ranks call it.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    #[doc(hidden)]
    pub fn merged<T>(&self, count: usize, own: Vec<T>) -> Result<Vec<T>, RankError>
    where
        T: Serialize + DeserializeOwned,
    {
        if self.count() == 1 {
            return Ok(own);
        }
        let mut shares: Vec<_> = self.exchange(own)?.into_iter().map(Vec::into_iter).collect();
        let found = |number| {
            let root = self.computes(number);
            shares[root].next().ok_or_else(|| unreadable(root, "too short"))
        };
        (0..count).map(found).collect()
    }

    /// The rank that computes a number. Numbers are distributed in rounds of alternating order: neighbours
    /// take about as long, but the two halves of a quad, say, may differ, and so may the ends of a mesh.
    fn computes(&self, number: usize) -> usize {
        let (round, place) = (number / self.count(), number % self.count());
        if round.is_multiple_of(2) { place } else { self.count() - 1 - place }
    }

    /// The results of `of` for all numbers below `count`, in order, as by [`map_init`](Self::map_init) but
    /// without scratch space. All ranks call it.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not run the same program.
    #[doc(hidden)]
    pub fn map<T>(&self, count: usize, of: impl Fn(usize) -> T + Send + Sync) -> Result<Vec<T>, RankError>
    where
        T: Serialize + DeserializeOwned + Send,
    {
        self.map_init(count, || (), |(), number| of(number))
    }

    /// What rank 0 computes, for all. All ranks call it.
    ///
    /// # Errors
    /// Fails if `compute` does on rank 0, or if another rank has ended or does not run the same program.
    #[doc(hidden)]
    pub fn by_first<T, E>(&self, compute: impl FnOnce() -> Result<T, E>) -> Result<T, E>
    where
        T: Serialize + DeserializeOwned,
        E: From<RankError>,
    {
        if self.count() == 1 {
            return compute();
        }
        let own = if self.rank() == 0 { Some(compute()?) } else { None };
        let mut sent = own.as_ref().map_or(Ok(Vec::new()), |own| encoded(0, own))?;
        let [length] = self.each([sent.len() as u64])?[0];
        let message = self.message(0, length, &mut sent)?;
        Ok(own.map_or_else(|| decoded(0, &message), Ok)?)
    }

    /// The values of each rank, by its number.
    fn exchange<T: Serialize + DeserializeOwned>(&self, own: Vec<T>) -> Result<Vec<Vec<T>>, RankError> {
        let mut sent = encoded(self.rank(), &own)?;
        let lengths = self.each([sent.len() as u64])?;
        let mut own = Some(own);
        let of = |(root, [length]): (usize, [u64; 1])| {
            let message = self.message(root, length, &mut sent)?;
            match own.take_if(|_| root == self.rank()) {
                Some(own) => Ok(own),
                None => decoded(root, &message),
            }
        };
        lengths.into_iter().enumerate().map(of).collect()
    }

    /// What `root` sends, which is `own` there.
    fn message(&self, root: usize, length: u64, own: &mut Vec<u8>) -> Result<Vec<u8>, RankError> {
        let mut bytes = if root == self.rank() { std::mem::take(own) } else { vec![0; length as usize] };
        self.broadcast(root, &mut bytes)?;
        Ok(bytes)
    }
}

fn encoded(rank: usize, values: &impl Serialize) -> Result<Vec<u8>, RankError> {
    postcard::to_stdvec(values).map_err(|error| unreadable(rank, error))
}

fn decoded<T: DeserializeOwned>(root: usize, message: &[u8]) -> Result<T, RankError> {
    match postcard::take_from_bytes(message) {
        Ok((values, [])) => Ok(values),
        Ok(_) => Err(unreadable(root, "too long")),
        Err(error) => Err(unreadable(root, error)),
    }
}

fn unreadable(root: usize, why: impl ToString) -> RankError {
    RankError::Unreadable { root, why: why.to_string() }
}

#[cfg(test)]
mod tests {
    use super::super::in_threads;
    use super::*;

    /// However many ranks, and however few numbers: the same results in the same order, each computed once.
    #[test]
    fn numbers_are_dealt_to_ranks() {
        let of = |number: usize| vec![0.1 * number as f64; number % 3];
        for (ranks, count) in [(1, 7), (2, 7), (3, 9), (4, 2), (3, 0)] {
            let wanted: Vec<_> = (0..count).map(of).collect();
            let computed = std::sync::Mutex::new(Vec::new());
            std::thread::scope(|scope| {
                for ranks in in_threads(ranks) {
                    let (wanted, computed) = (&wanted, &computed);
                    scope.spawn(move || {
                        let found = ranks.map(count, |number| {
                            computed.lock().expect("numbers").push(number);
                            of(number)
                        });
                        assert_eq!(found.as_ref(), Ok(wanted));
                    });
                }
            });
            let mut computed = computed.into_inner().expect("numbers");
            computed.sort_unstable();
            assert_eq!(computed, (0..count).collect::<Vec<_>>());
        }
    }

    #[test]
    fn all_get_what_the_first_computes() {
        std::thread::scope(|scope| {
            for ranks in in_threads(3) {
                scope.spawn(move || {
                    let found = ranks.by_first(|| {
                        assert_eq!(ranks.rank(), 0);
                        Ok::<_, RankError>(vec![0.1; 5])
                    });
                    assert_eq!(found, Ok(vec![0.1; 5]));
                });
            }
        });
    }

    /// One rank cannot read what the other sends, and says so; the other waits for it.
    #[test]
    fn ranks_that_send_something_else_are_an_error() {
        std::thread::scope(|scope| {
            for ranks in in_threads(2) {
                scope.spawn(move || match ranks.rank() {
                    0 => assert_eq!(ranks.map(2, |_| String::from("a")), Err(RankError::Left)),
                    _ => {
                        let error = ranks.map(2, |_| [0.5; 2]).expect_err("not a number");
                        assert!(error.to_string().contains("what rank 0 has sent"), "{error}");
                    }
                });
            }
        });
    }
}
