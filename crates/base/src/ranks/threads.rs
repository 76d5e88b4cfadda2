//! Ranks that are threads of one process, for tests and for several devices of one machine.

use super::{Communicator, RankError, Ranks};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// One message at a time: the root puts it here, and takes it away when all others have read it.
struct Board {
    /// Messages before this one.
    round: u64,
    message: Option<Vec<u8>>,
    /// Ranks that have read it.
    readers: usize,
    /// The first message that not all ranks take part in, since one has ended.
    last: u64,
}

struct Shared {
    board: Mutex<Board>,
    changed: Condvar,
}

struct ThreadRank {
    rank: usize,
    count: usize,
    /// Messages that this rank has sent or read.
    round: AtomicU64,
    shared: Arc<Shared>,
}

/// Ranks for as many threads. Where one is dropped while another waits for it, the other gets an error.
pub fn in_threads(count: usize) -> Vec<Ranks> {
    let board = Board { round: 0, message: None, readers: 0, last: u64::MAX };
    let shared = Arc::new(Shared { board: Mutex::new(board), changed: Condvar::new() });
    (0..count)
        .map(|rank| Ranks::new(ThreadRank { rank, count, round: AtomicU64::new(0), shared: shared.clone() }))
        .collect()
}

impl ThreadRank {
    fn board(&self) -> MutexGuard<'_, Board> {
        self.shared.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until the board is as wanted for a message.
    fn until<'a>(
        &self,
        board: MutexGuard<'a, Board>,
        round: u64,
        wanted: impl Fn(&Board) -> bool,
    ) -> Result<MutexGuard<'a, Board>, RankError> {
        let waiting = |board: &mut Board| !wanted(board) && round < board.last;
        let board = self.shared.changed.wait_while(board, waiting).unwrap_or_else(PoisonError::into_inner);
        if wanted(&board) { Ok(board) } else { Err(RankError::Left) }
    }
}

impl Communicator for ThreadRank {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.count
    }

    fn broadcast(&self, root: usize, bytes: &mut [u8]) -> Result<(), RankError> {
        let others = self.count - 1;
        if others == 0 {
            return Ok(());
        }
        let round = self.round.fetch_add(1, Ordering::SeqCst);
        let mut board = self.until(self.board(), round, |board| {
            board.round == round && (root == self.rank || board.message.is_some())
        })?;
        if root == self.rank {
            board.message = Some(bytes.to_vec());
            self.shared.changed.notify_all();
            board = self.until(board, round, |board| board.readers == others)?;
            (board.round, board.message, board.readers) = (round + 1, None, 0);
        } else if let Some(message) = &board.message {
            if message.len() != bytes.len() {
                let error = RankError::OutOfStep { root, sent: message.len(), given: bytes.len() };
                // Not even in this one.
                board.last = board.last.min(round);
                self.shared.changed.notify_all();
                return Err(error);
            }
            bytes.copy_from_slice(message);
            board.readers += 1;
        }
        self.shared.changed.notify_all();
        Ok(())
    }
}

impl Drop for ThreadRank {
    fn drop(&mut self) {
        let mut board = self.board();
        board.last = board.last.min(self.round.load(Ordering::SeqCst));
        drop(board);
        self.shared.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn every_rank_gets_what_each_sends() {
        thread::scope(|scope| {
            for ranks in in_threads(3) {
                scope.spawn(move || {
                    for round in 0..100_u8 {
                        for root in 0..3 {
                            let mut bytes = [ranks.rank() as u8, round];
                            ranks.broadcast(root, &mut bytes).expect("a broadcast");
                            assert_eq!(bytes, [root as u8, round]);
                        }
                        assert_eq!(ranks.each([7 - ranks.rank() as u64]), Ok(vec![[7], [6], [5]]));
                        let mut value = [f64::from(round) + ranks.rank() as f64];
                        ranks.agree(&mut value).expect("agreement");
                        assert_eq!(value, [f64::from(round)]);
                    }
                    // One of two bytes a round; three of 8 bytes; one value.
                    let of_zero = if ranks.rank() == 0 { 8 } else { 0 };
                    assert_eq!(ranks.moved(), [100 * (2 + 8 + of_zero), 100 * (4 + 16 + 8 - of_zero)]);
                });
            }
        });
    }

    #[test]
    fn a_rank_that_ends_ends_the_others() {
        let mut ranks = in_threads(3);
        let dead = ranks.pop();
        thread::scope(|scope| {
            for ranks in ranks {
                scope.spawn(move || {
                    let results = [2, 1].map(|root| ranks.broadcast(root, &mut [0; 4]));
                    assert_eq!(results[0], Err(RankError::Left));
                });
            }
            drop(dead);
        });
    }

    #[test]
    fn ranks_out_of_step_are_an_error() {
        thread::scope(|scope| {
            for ranks in in_threads(2) {
                scope.spawn(move || {
                    let mut bytes = vec![0; 4 + ranks.rank()];
                    let error = ranks.broadcast(0, &mut bytes).expect_err("other lengths");
                    let expected = [RankError::Left, RankError::OutOfStep { root: 0, sent: 4, given: 5 }];
                    assert_eq!(error, expected[ranks.rank()]);
                });
            }
        });
    }
}
