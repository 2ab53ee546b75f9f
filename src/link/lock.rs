//! The lock of the commands that must not be given by accident. It locks itself again after [`UNLOCKED_US`].

/// The word that unlocks. The word is not secret: it protects against stray bytes and operating errors, not against
/// people.
pub const UNLOCK_WORD: u32 = 0x5e1f_ca11;

/// Time after which the lock locks itself again, us.
pub const UNLOCKED_US: u64 = 30_000_000;

/// The lock. It is locked at first.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lock {
    unlocked_us: Option<u64>,
}

impl Lock {
    /// A lock that is locked.
    pub const fn new() -> Self {
        Self { unlocked_us: None }
    }

    /// Unlocks from `now_us` on if the word is right; otherwise locks. Returns whether the word was right.
    pub fn unlock(&mut self, word: u32, now_us: u64) -> bool {
        self.unlocked_us = (word == UNLOCK_WORD).then_some(now_us);
        self.unlocked_us.is_some()
    }

    /// Whether the lock is open. If the clock went back, it is locked.
    pub fn is_unlocked(&self, now_us: u64) -> bool {
        let since = self.unlocked_us.and_then(|then| now_us.checked_sub(then));
        since.is_some_and(|since_us| since_us < UNLOCKED_US)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_right_word_unlocks_for_its_time_and_a_wrong_one_locks() {
        let mut lock = Lock::new();
        assert!(!lock.is_unlocked(0));
        assert!(lock.unlock(UNLOCK_WORD, 1000));
        assert!(lock.is_unlocked(1000) && lock.is_unlocked(999 + UNLOCKED_US));
        assert!(!lock.is_unlocked(1000 + UNLOCKED_US) && !lock.is_unlocked(999));
        assert!(!lock.unlock(UNLOCK_WORD ^ 1, 2000));
        assert!(!lock.is_unlocked(2000));
    }
}
