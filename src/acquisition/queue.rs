//! Queue of raw samples from the interrupt of the IMU to the main loop.
//!
//! The two ends of the queue have different types: one [`SampleProducer`] for the interrupt and one [`SampleConsumer`]
//! for the main loop. The producer counts every missing sample by its reason; the consumer reads the counters.

use crate::base::linear::Real;
use crate::base::loss::{LossCounts, LossReason};
use crate::base::sample::RawSample;
use crate::gimbal::GimbalStatus;
use core::sync::atomic::{AtomicU32, Ordering};
use heapless::spsc;

/// A raw sample and the gimbal status at that time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SampleWithGimbal<T: Real> {
    /// The sample.
    pub sample: RawSample<T>,
    /// Status of the gimbal.
    pub gimbal: GimbalStatus,
}

/// Counters. Only the producer writes them; both ends read them.
struct Counters {
    overrun: AtomicU32,
    bus: AtomicU32,
    crc: AtomicU32,
    status: AtomicU32,
    unread: AtomicU32,
    restarted: AtomicU32,
    most_waiting: AtomicU32,
}

/// Memory of the queue. It holds `N - 1` samples.
pub struct SampleQueue<T: Real, const N: usize> {
    samples: spsc::Queue<SampleWithGimbal<T>, N>,
    counters: Counters,
}

impl<T: Real, const N: usize> SampleQueue<T, N> {
    /// An empty queue.
    pub const fn new() -> Self {
        let counters = Counters {
            overrun: AtomicU32::new(0),
            bus: AtomicU32::new(0),
            crc: AtomicU32::new(0),
            status: AtomicU32::new(0),
            unread: AtomicU32::new(0),
            restarted: AtomicU32::new(0),
            most_waiting: AtomicU32::new(0),
        };
        Self { samples: spsc::Queue::new(), counters }
    }

    /// Splits the queue into its two ends.
    pub fn split(&mut self) -> (SampleProducer<'_, T>, SampleConsumer<'_, T>) {
        let (producer, consumer) = self.samples.split();
        let counters = &self.counters;
        (SampleProducer { samples: producer, counters }, SampleConsumer { samples: consumer, counters })
    }
}

impl<T: Real, const N: usize> Default for SampleQueue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Always true, because a queue with `N` < 2 does not compile. The two ends do not know `N` and take an index modulo
/// the capacity; this test shows the compiler that the division cannot panic.
fn has_memory(capacity: usize) -> bool {
    capacity != usize::MAX
}

/// The interrupt's end of the queue.
pub struct SampleProducer<'q, T: Real> {
    samples: spsc::Producer<'q, SampleWithGimbal<T>>,
    counters: &'q Counters,
}

impl<T: Real> SampleProducer<'_, T> {
    /// Appends a sample. If the queue is full, the new sample is dropped and counted as an overrun.
    ///
    /// # Errors
    /// [`LossReason::Overrun`] if the queue is full. The loss is already counted.
    pub fn push(&mut self, sample: SampleWithGimbal<T>) -> Result<(), LossReason> {
        if has_memory(self.samples.capacity()) && self.samples.enqueue(sample).is_ok() {
            let most_waiting = &self.counters.most_waiting;
            most_waiting.store(most_waiting.load(Ordering::Relaxed).max(self.samples.len() as u32), Ordering::Relaxed);
            return Ok(());
        }
        self.count(LossReason::Overrun, 1);
        Err(LossReason::Overrun)
    }

    /// Counts samples that were lost before they reached the queue.
    pub fn count(&mut self, loss: LossReason, samples: u32) {
        let counter = match loss {
            LossReason::Overrun => &self.counters.overrun,
            LossReason::Bus => &self.counters.bus,
            LossReason::Crc => &self.counters.crc,
            LossReason::Status => &self.counters.status,
            LossReason::Unread => &self.counters.unread,
            LossReason::Restarted => &self.counters.restarted,
        };
        // No other code writes this counter, so load and store need not be one atomic step.
        counter.store(counter.load(Ordering::Relaxed).saturating_add(samples), Ordering::Relaxed);
    }
}

/// The main loop's end of the queue.
pub struct SampleConsumer<'q, T: Real> {
    samples: spsc::Consumer<'q, SampleWithGimbal<T>>,
    counters: &'q Counters,
}

impl<T: Real> SampleConsumer<'_, T> {
    /// Takes the oldest sample out of the queue.
    pub fn pop(&mut self) -> Option<SampleWithGimbal<T>> {
        if has_memory(self.samples.capacity()) { self.samples.dequeue() } else { None }
    }

    /// Whether the queue is empty.
    pub fn is_empty(&self) -> bool {
        !self.samples.ready()
    }

    /// Largest number of samples that have waited in the queue so far.
    pub fn most_waiting(&self) -> u32 {
        self.counters.most_waiting.load(Ordering::Relaxed)
    }

    /// Counters of the missing samples.
    pub fn losses(&self) -> LossCounts {
        let load = |counter: &AtomicU32| counter.load(Ordering::Relaxed);
        LossCounts {
            overrun: load(&self.counters.overrun),
            bus: load(&self.counters.bus),
            crc: load(&self.counters.crc),
            status: load(&self.counters.status),
            unread: load(&self.counters.unread),
            restarted: load(&self.counters.restarted),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(time_us: u64) -> SampleWithGimbal<f32> {
        SampleWithGimbal { sample: RawSample { time_us, ..RawSample::default() }, ..SampleWithGimbal::default() }
    }

    #[test]
    fn samples_come_out_in_order_across_threads() {
        let mut queue = SampleQueue::<f32, 8>::new();
        let (mut producer, mut consumer) = queue.split();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for time_us in 0..10_000 {
                    while producer.push(sample(time_us)).is_err() {
                        std::thread::yield_now();
                    }
                }
            });
            let popped = core::iter::from_fn(|| {
                loop {
                    match consumer.pop() {
                        Some(observed) => return Some(observed.sample.time_us),
                        None => std::thread::yield_now(),
                    }
                }
            });
            assert!(popped.take(10_000).eq(0..10_000));
        });
    }

    #[test]
    fn an_overrun_keeps_the_old_samples_and_is_counted() {
        let mut queue = SampleQueue::<f32, 4>::new();
        let (mut producer, mut consumer) = queue.split();
        let pushed: Vec<_> = (0..5).map(|time_us| producer.push(sample(time_us)).is_ok()).collect();
        assert_eq!(pushed, [true, true, true, false, false]);
        assert_eq!(consumer.losses(), LossCounts { overrun: 2, ..LossCounts::default() });
        assert_eq!(consumer.most_waiting(), 3);
        assert!((0..3).all(|time_us| consumer.pop().map(|observed| observed.sample.time_us) == Some(time_us)));
        assert!(consumer.is_empty());
    }

    #[test]
    fn counters_saturate() {
        let mut queue = SampleQueue::<f32, 4>::new();
        let (mut producer, consumer) = queue.split();
        producer.count(LossReason::Unread, u32::MAX);
        producer.count(LossReason::Unread, 5);
        producer.count(LossReason::Bus, 1);
        assert_eq!(consumer.losses().unread, u32::MAX);
        assert_eq!(consumer.losses().total(), u32::MAX);
    }
}
