//! Numbers of a PWM that stops by itself: the one-pulse mode of a timer with a repetition counter.
//!
//! Source: STMicroelectronics, reference manual RM0433 of the STM32H743, advanced-control timers TIM1 and TIM8.
//!
//! ```text
//! count    0 to reload, then 0 again: one cycle of the PWM
//! output   PWM mode 2: inactive while count < compare, then active to the end of the cycle
//! stop     at count 0 after repetitions + 1 cycles: at the update event, with OPM set
//! arming   an update event by software (UG): count and repetitions begin again, and new compare values take effect
//! ```
//! Control arms the timer in every control period. If control dies, the timer stops, and the output stays inactive. In PWM
//! mode 1 the output of a stopped timer would be active, because the count is below the compare value. In mode 2 it is
//! inactive as long as the compare value is not zero, so the highest duty is one count less than a cycle.
//!
//! Arming ends a cycle early. The control period should be a number of whole cycles and a part of a cycle: then the arming
//! falls into the inactive part of a cycle, and a delay of it changes no pulse. If the control period were whole cycles only,
//! a delay would decide whether the last pulse is cut off.

/// Numbers of the timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OnePulsePwm {
    /// Counts of a cycle.
    cycle: u16,
    repetitions: u16,
}

impl OnePulsePwm {
    /// A timer of 16 bits with the clock `clock_hz` that gives at least `pwm_hz` cycles a second and stops at most
    /// `longest_us` after it has been armed. `None` if the cycle has fewer than 2 or more than 65535 counts, or if
    /// `longest_us` is not between 1 and 65536 cycles.
    pub const fn new(clock_hz: u32, pwm_hz: u32, longest_us: u32) -> Option<Self> {
        let Some(cycle) = clock_hz.checked_div(pwm_hz) else { return None };
        if cycle < 2 || cycle > u16::MAX as u32 {
            return None;
        }
        let longest = longest_us as u64 * clock_hz as u64 / 1_000_000;
        let Some(cycles) = longest.checked_div(cycle as u64) else { return None };
        if cycles == 0 || cycles > u16::MAX as u64 + 1 {
            return None;
        }
        Some(Self { cycle: cycle as u16, repetitions: (cycles - 1) as u16 })
    }

    /// Value of the auto-reload register: the highest count.
    pub const fn reload(&self) -> u16 {
        self.cycle.saturating_sub(1)
    }

    /// Value of the repetition counter's register: cycles until the stop, minus one.
    pub const fn repetitions(&self) -> u16 {
        self.repetitions
    }

    /// Highest duty, counts. The output is active for as many counts of a cycle as the duty says.
    pub const fn highest_duty(&self) -> u16 {
        self.cycle.saturating_sub(1)
    }

    /// Value of the compare register for a duty, at least 1. A larger duty than the highest is the highest.
    pub fn compare(&self, duty: u16) -> u16 {
        self.cycle.saturating_sub(duty.min(self.highest_duty()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The timer of the board: 240 MHz, 20.4 kHz, 5 ms.
    fn board() -> OnePulsePwm {
        OnePulsePwm::new(240_000_000, 20_400, 5000).unwrap()
    }

    /// The timer as the reference manual describes it, in PWM mode 2 with the one-pulse mode.
    struct Timer {
        numbers: OnePulsePwm,
        count: u16,
        repetitions: u16,
        runs: bool,
        written: u16,
        compare: u16,
    }

    impl Timer {
        fn new(numbers: OnePulsePwm) -> Self {
            Self { numbers, count: 0, repetitions: 0, runs: false, written: numbers.compare(0), compare: 0 }
        }

        fn set(&mut self, duty: u16) {
            self.written = self.numbers.compare(duty);
        }

        fn update(&mut self) {
            (self.count, self.compare, self.repetitions) = (0, self.written, self.numbers.repetitions());
        }

        fn arm(&mut self) {
            self.update();
            self.runs = true;
        }

        /// Advances by one count. Returns whether the output was active.
        fn advance(&mut self) -> bool {
            let active = self.count >= self.compare;
            if !self.runs {
                return active;
            }
            self.count += 1;
            if self.count > self.numbers.reload() {
                self.count = 0;
                match self.repetitions.checked_sub(1) {
                    Some(left) => self.repetitions = left,
                    None => {
                        self.update();
                        self.runs = false;
                    }
                }
            }
            active
        }

        /// Number of counts at which the output was active.
        fn active(&mut self, counts: u32) -> u32 {
            (0..counts).map(|_| u32::from(self.advance())).sum()
        }
    }

    #[test]
    fn the_board_has_these_numbers() {
        let numbers = board();
        assert_eq!((numbers.reload(), numbers.repetitions(), numbers.highest_duty()), (11_763, 101, 11_763));
        assert_eq!([0, 1, 11_763, u16::MAX].map(|duty| numbers.compare(duty)), [11_764, 11_763, 1, 1]);
    }

    #[test]
    fn the_output_is_active_as_long_as_the_duty_says_and_never_after_the_stop() {
        let numbers = board();
        let cycle = u32::from(numbers.reload()) + 1;
        for duty in [0, 1, 2, 5000, 11_762, 11_763] {
            let mut timer = Timer::new(numbers);
            timer.set(duty);
            timer.arm();
            for _ in 0..=numbers.repetitions() {
                assert!(timer.runs);
                assert_eq!(timer.active(cycle), duty.into());
            }
            assert!(!timer.runs);
            assert_eq!(timer.active(10 * cycle), 0, "{duty}");
        }
    }

    #[test]
    fn a_timer_that_was_never_armed_has_no_output() {
        let mut timer = Timer::new(board());
        timer.update();
        timer.set(5000);
        assert_eq!(timer.active(100_000), 0);
    }

    #[test]
    fn the_output_ends_within_the_longest_time_and_lasts_longer_than_four_control_periods() {
        let mut timer = Timer::new(board());
        timer.set(11_763);
        timer.arm();
        // 5 ms and 4 ms at 240 MHz.
        let ends = (1..2_000_000)
            .find(|_| {
                timer.advance();
                !timer.runs
            })
            .unwrap();
        assert!((960_000..=1_200_000).contains(&ends), "{ends}");
    }

    /// Control arms once a millisecond, late by up to 15 us. In every period there are the pulses of 20 cycles, so the mean
    /// duty does not depend on the delays.
    #[test]
    fn late_arming_changes_no_pulse() {
        for duty in [1, 100, 3000, 5500] {
            let mut timer = Timer::new(board());
            timer.set(duty);
            timer.arm();
            let mut late = 0;
            for period in 0..200_u32 {
                let later = period * 1_103 % 3_600;
                let counts = 240_000 + later - late;
                assert_eq!(timer.active(counts), 20 * u32::from(duty), "{period}");
                timer.arm();
                late = later;
            }
        }
    }

    #[test]
    fn a_new_duty_takes_effect_when_the_timer_is_armed() {
        let mut timer = Timer::new(board());
        timer.arm();
        timer.set(5000);
        assert_eq!(timer.active(11_764), 0);
        timer.arm();
        assert_eq!(timer.active(11_764), 5000);
    }

    #[test]
    fn numbers_that_do_not_fit_are_refused() {
        for (clock_hz, pwm_hz, longest_us) in
            [(240_000_000, 0, 5000), (240_000_000, 3000, 5000), (240_000_000, 20_400, 49), (1000, 1000, 5000)]
        {
            assert_eq!(OnePulsePwm::new(clock_hz, pwm_hz, longest_us), None);
        }
    }

    proptest! {
        #[test]
        fn no_timer_runs_too_long(clock_hz in 1_000_000_u32..500_000_000, pwm_hz in 1000_u32..200_000, longest_us: u16) {
            if let Some(numbers) = OnePulsePwm::new(clock_hz, pwm_hz, longest_us.into()) {
                let cycle = u64::from(numbers.reload()) + 1;
                let counts = cycle * (u64::from(numbers.repetitions()) + 1);
                prop_assert!(counts * 1_000_000 <= u64::from(longest_us) * u64::from(clock_hz));
                prop_assert!(u64::from(clock_hz) / cycle >= u64::from(pwm_hz));
                prop_assert!((1..=cycle).contains(&numbers.compare(longest_us).into()));
            }
        }
    }
}
