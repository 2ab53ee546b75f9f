//! The board: QEMU's `mps2-an500`, a Cortex-M7 with double precision. Everything that is unsafe, static or hardware.
//!
//! The devices on SPI are played by the host, behind named pipes opened by semihosting: a transfer is a request of chip
//! number, length and bytes, answered by as many bytes. A semihosting call stops the virtual processor, so host and guest
//! go in lock step.
//!
//! The emulator's auto-reload timers run at half rate while the processor sleeps (QEMU 7.2). Data-ready edges therefore
//! come from a one-shot timer, armed anew in its handler against a free-running one.
#![allow(unsafe_code)]

use crate::Scalar;
use crate::bit_bang_i2c::BitBangI2c;
use core::arch::naked_asm;
use core::cell::{Cell, RefCell, UnsafeCell};
use core::convert::Infallible;
use core::ffi::CStr;
use core::panic::PanicInfo;
use core::ptr;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use cortex_m_semihosting::{debug, nr, syscall};
use critical_section::Mutex;
use eeprom24x::{Eeprom24x, SlaveAddr, addr_size, page_size, unique_serial};
use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{ErrorType as PinErrorType, InputPin, OutputPin};
use embedded_hal::spi::{Error as SpiError, ErrorKind, ErrorType as SpiErrorType, Operation, SpiDevice};
use rins_selfcal::acquisition::{Acquired, Acquisition};
use rins_selfcal::device::{Encoder, Imu, RateDrive};
use rins_selfcal::queue::{SampleConsumer, SampleQueue};
use rins_selfcal::store::CalibrationStore;

/// Ticks of the system clock per second.
const TICKS_PER_S: u32 = 25_000_000;
/// Ticks from one data-ready edge to the next: 200 Hz.
const TICKS_PER_EDGE: u32 = TICKS_PER_S / 200;
/// Depth of the sample queue plus one: 0.31 s at 200 Hz. The main loop is busy longest when it writes a record to the
/// EEPROM, for 0.21 s; no more than 42 samples were seen to wait.
const QUEUE_LENGTH: usize = 64;
/// Longest transfer on SPI, bytes.
const MAX_TRANSFER_BYTES: usize = 96;
/// Size of the no-access region at the bottom of the stack, bytes.
const GUARD_BYTES: usize = 256;

// ---------------------------------------------------------------------------------------------------------- registers

/// A 32-bit register.
#[derive(Clone, Copy)]
struct Register(usize);

impl Register {
    fn read(self) -> u32 {
        // Safety: made only from the constants below, addresses of registers that are free of side effects on memory, and
        // from addresses within the stack, which may be read.
        unsafe { ptr::read_volatile(self.0 as *const u32) }
    }

    fn write(self, value: u32) {
        // Safety: as above; of the stack nothing is written.
        unsafe { ptr::write_volatile(self.0 as *mut u32, value) }
    }
}

/// One of the CMSDK timers, which count down.
struct Timer(usize);

impl Timer {
    const ENABLE: u32 = 1;
    const ENABLE_INTERRUPT: u32 = 8;

    const fn register(&self, offset: usize) -> Register {
        Register(self.0 + offset)
    }
    const fn control(&self) -> Register {
        self.register(0x0)
    }
    const fn value(&self) -> Register {
        self.register(0x4)
    }
    const fn reload(&self) -> Register {
        self.register(0x8)
    }
    const fn interrupt_clear(&self) -> Register {
        self.register(0xc)
    }
}

const EDGE_TIMER: Timer = Timer(0x4000_0000);
const CLOCK_TIMER: Timer = Timer(0x4000_1000);
const I2C_SET: Register = Register(0x4002_a000);
const I2C_CLEAR: Register = Register(0x4002_a004);

/// The interrupt of `EDGE_TIMER`.
#[derive(Clone, Copy)]
struct DataReady;

// Safety: 8 is the timer's line on this board.
unsafe impl InterruptNumber for DataReady {
    fn number(self) -> u16 {
        8
    }
}

// --------------------------------------------------------------------------------------------------------------- time

/// Time at the last look, ticks. Looked at 200 times a second, so that the 32-bit timer never wraps unseen.
static CLOCK: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

fn timer_ticks() -> u32 {
    !CLOCK_TIMER.value().read()
}

/// Ticks since power-up.
fn ticks() -> u64 {
    critical_section::with(|cs| {
        let clock = CLOCK.borrow(cs);
        let now = clock.get() + u64::from(timer_ticks().wrapping_sub(clock.get() as u32));
        clock.set(now);
        now
    })
}

defmt::timestamp!("{=u64:us}", ticks() / 25);

/// Delays by counting instructions, of which the emulator executes one in 2 ns.
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        cortex_m::asm::delay(ns.div_ceil(2));
    }
}

// -------------------------------------------------------------------------------------------------------------- work

/// Ticks that are nobody's own work: transfers, telemetry, and the interrupt, which may come into any other span. Written
/// by the interrupt and the main loop; spans nest, so each knows what came into it.
static ASIDE: AtomicU32 = AtomicU32::new(0);

/// Time from here on.
pub struct Span {
    start: u32,
    aside: u32,
}

impl Span {
    /// Begins now.
    pub fn start() -> Self {
        Self { start: timer_ticks(), aside: ASIDE.load(Ordering::Relaxed) }
    }

    fn ticks(&self) -> u32 {
        timer_ticks().wrapping_sub(self.start)
    }

    /// Ticks so far, without what is put aside.
    fn own_ticks(&self) -> u32 {
        critical_section::with(|_| self.ticks().wrapping_sub(ASIDE.load(Ordering::Relaxed).wrapping_sub(self.aside)))
    }

    /// Puts all of it aside.
    pub fn put_aside(self) {
        critical_section::with(|_| ASIDE.store(self.aside.wrapping_add(self.ticks()), Ordering::Relaxed));
    }
}

/// What a span was for. The order is that of the file `run`.
#[derive(Clone, Copy)]
pub enum Work {
    /// The interrupt.
    Interrupt,
    /// A sample while the axes stand.
    Stop,
    /// A sample while they turn.
    Move,
    /// A sample that ends a segment.
    Segment,
    /// A piece of the final pass.
    Solve,
    /// A sample that is corrected.
    Correct,
    /// Everything else.
    Other,
}

/// Spans of one kind of work.
#[derive(Clone, Copy)]
struct Load {
    spans: u32,
    ticks: u64,
    longest: u32,
}

static LOADS: Mutex<Cell<[Load; Work::Other as usize + 1]>> =
    Mutex::new(Cell::new([Load { spans: 0, ticks: 0, longest: 0 }; Work::Other as usize + 1]));

/// Counts a span, which ends here.
pub fn count(work: Work, span: &Span) {
    let ticks = span.own_ticks();
    critical_section::with(|cs| {
        let mut loads = LOADS.borrow(cs).get();
        if let Some(load) = loads.get_mut(work as usize) {
            load.spans = load.spans.wrapping_add(1);
            load.ticks += u64::from(ticks);
            load.longest = load.longest.max(ticks);
        }
        LOADS.borrow(cs).set(loads);
    });
}

// -------------------------------------------------------------------------------------------------------- semihosting

/// A file of the host.
#[derive(Clone, Copy)]
struct File(usize);

impl File {
    const READ: usize = 1;
    const WRITE: usize = 5;

    fn open(name: &CStr, mode: usize) -> Option<Self> {
        // Safety: address, mode and length of a string that outlives the call.
        let handle = unsafe { syscall(nr::OPEN, &[name.as_ptr() as usize, mode, name.count_bytes()]) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Whether all bytes were written.
    fn write(self, bytes: &[u8]) -> bool {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        unsafe { syscall(nr::WRITE, &[self.0, bytes.as_ptr() as usize, bytes.len()]) == 0 }
    }

    /// Number of bytes read; none at the end of the file.
    fn read(self, bytes: &mut [u8]) -> usize {
        // Safety: address and length of bytes that outlive the call; it returns the number left over.
        let left = unsafe { syscall(nr::READ, &[self.0, bytes.as_mut_ptr() as usize, bytes.len()]) };
        bytes.len().saturating_sub(left)
    }

    /// Whether all of `bytes` was filled.
    fn read_exact(self, mut bytes: &mut [u8]) -> bool {
        while !bytes.is_empty() {
            let count = self.read(bytes);
            match bytes.get_mut(count..) {
                Some(rest) if count > 0 => bytes = rest,
                _ => return false,
            }
        }
        true
    }
}

fn exit(status: Result<(), ()>) -> ! {
    loop {
        debug::exit(status);
    }
}

// ------------------------------------------------------------------------------------------------------ SPI over pipes

/// Whether the instrument is switched on. Cleared by the interrupt, read by the main loop.
static POWERED: AtomicBool = AtomicBool::new(true);

/// Number of a chip on the host's bench.
#[derive(Clone, Copy)]
enum Chip {
    Imu = 0,
    OuterEncoder = 1,
    InnerEncoder = 2,
    OuterDrive = 3,
    InnerDrive = 4,
}

/// The bus: one pipe for requests and one for answers.
#[derive(Clone, Copy)]
struct PipeBus {
    requests: File,
    answers: File,
}

/// One chip on the bus.
pub struct PipeSpi {
    bus: PipeBus,
    chip: Chip,
}

/// Fault of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PipeFault {
    /// The host has closed the pipes.
    Closed,
    /// More than one operation, another than a full-duplex transfer in place, or more bytes than the bus takes.
    Unsupported,
}

impl SpiError for PipeFault {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl SpiErrorType for PipeSpi {
    type Error = PipeFault;
}

impl SpiDevice for PipeSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), PipeFault> {
        let [Operation::TransferInPlace(frame)] = operations else { return Err(PipeFault::Unsupported) };
        // The interrupt and the main loop share the bus.
        critical_section::with(|_| {
            let span = Span::start();
            let done = self.bus.transfer(self.chip, frame);
            span.put_aside();
            done
        })
    }
}

impl PipeBus {
    fn transfer(self, chip: Chip, frame: &mut [u8]) -> Result<(), PipeFault> {
        let mut request = [0; 2 + MAX_TRANSFER_BYTES];
        let [number, length, bytes @ ..] = &mut request;
        *number = chip as u8;
        *length = u8::try_from(frame.len()).map_err(|_| PipeFault::Unsupported)?;
        bytes.get_mut(..frame.len()).ok_or(PipeFault::Unsupported)?.copy_from_slice(frame);
        let request = request.get(..2 + frame.len()).ok_or(PipeFault::Unsupported)?;
        if POWERED.load(Ordering::Relaxed) && self.requests.write(request) && self.answers.read_exact(frame) {
            Ok(())
        } else {
            POWERED.store(false, Ordering::Relaxed);
            Err(PipeFault::Closed)
        }
    }
}

// ---------------------------------------------------------------------------------------------------- data-ready edges

type BoardAcquisition = Acquisition<'static, Scalar, PipeSpi, PipeSpi, PipeSpi>;

/// Filled once at power-up, used by the interrupt only.
static ACQUISITION: Mutex<RefCell<Option<BoardAcquisition>>> = Mutex::new(RefCell::new(None));
/// Time of the next edge on the free-running timer. Written at the start, then by the interrupt only.
static NEXT_EDGE: AtomicU32 = AtomicU32::new(0);
/// Edges that came after their time because the processor was busy. Written by the interrupt.
static LATE_EDGES: AtomicU32 = AtomicU32::new(0);

fn arm_next_edge() {
    let edge = NEXT_EDGE.load(Ordering::Relaxed).wrapping_add(TICKS_PER_EDGE);
    NEXT_EDGE.store(edge, Ordering::Relaxed);
    let remaining = edge.wrapping_sub(timer_ticks());
    let late = remaining.cast_signed() <= 0;
    if late {
        LATE_EDGES.store(LATE_EDGES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
    EDGE_TIMER.value().write(if late { 1 } else { remaining });
}

fn on_data_ready() {
    let span = Span::start();
    acquire();
    count(Work::Interrupt, &span);
    span.put_aside();
}

fn acquire() {
    EDGE_TIMER.interrupt_clear().write(1);
    if !POWERED.load(Ordering::Relaxed) {
        return;
    }
    arm_next_edge();
    ticks();
    critical_section::with(|cs| {
        if let Ok(mut acquisition) = ACQUISITION.borrow(cs).try_borrow_mut()
            && let Some(acquisition) = acquisition.as_mut()
            && acquisition.on_data_ready() == Acquired::PoweredOff
        {
            POWERED.store(false, Ordering::Relaxed);
        }
    });
}

/// Every interrupt comes here; only one is enabled.
#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) {
    if number == 8 {
        on_data_ready();
    } else {
        stop("unexpected interrupt", &[number as u32]);
    }
}

// ------------------------------------------------------------------------------------------------------------- EEPROM

/// A line of the bit-banged I2C: open drain, so both directions at once.
pub struct Line(u32);

const SCL: Line = Line(1);
const SDA: Line = Line(2);

impl PinErrorType for Line {
    type Error = Infallible;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Infallible> {
        I2C_CLEAR.write(self.0);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        I2C_SET.write(self.0);
        Ok(())
    }
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(I2C_SET.read() & self.0 != 0)
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The EEPROM, a 24x64 of 8 KiB.
pub type Eeprom =
    eeprom24x::Storage<BitBangI2c<Line, Line, Delay>, page_size::B32, addr_size::TwoBytes, unique_serial::No, Delay>;

fn eeprom() -> Eeprom {
    let i2c = BitBangI2c::new(SCL, SDA, Delay);
    eeprom24x::Storage::new(Eeprom24x::new_24x64(i2c, SlaveAddr::default()), Delay)
}

// --------------------------------------------------------------------------------------------------------------- logs

struct Log {
    restore: critical_section::RestoreState,
    encoder: defmt::Encoder,
    open: bool,
    file: Option<File>,
    buffer: heapless::Vec<u8, 256>,
}

impl Log {
    fn put(&mut self, encode: impl FnOnce(&mut defmt::Encoder, &mut dyn FnMut(&[u8]))) {
        let Self { encoder, file, buffer, .. } = self;
        encode(encoder, &mut |bytes| {
            if buffer.extend_from_slice(bytes).is_err() {
                flush(*file, buffer);
                let _ = buffer.extend_from_slice(bytes);
            }
        });
    }
}

fn flush(file: Option<File>, buffer: &mut heapless::Vec<u8, 256>) {
    if let Some(file) = file {
        // A log that cannot be written is lost, and nothing else.
        let _ = file.write(buffer);
    }
    buffer.clear();
}

struct LogCell(UnsafeCell<Log>);

// Safety: touched between `acquire` and `release` only, which hold a critical section on the only core.
unsafe impl Sync for LogCell {}

static LOG: LogCell = LogCell(UnsafeCell::new(Log {
    restore: critical_section::RestoreState::invalid(),
    encoder: defmt::Encoder::new(),
    open: false,
    file: None,
    buffer: heapless::Vec::new(),
}));

/// Logs go to the host's log pipe, one write to a frame.
#[defmt::global_logger]
struct Logger;

// Safety: a frame is one critical section; one inside another ends the program.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // Safety: released in `release`; the reference ends with this function.
        let (restore, log) = unsafe { (critical_section::acquire(), &mut *LOG.0.get()) };
        if log.open {
            stop("log inside a log", &[]);
        }
        log.open = true;
        log.restore = restore;
        log.file = log.file.or_else(|| File::open(c"log", File::WRITE));
        log.put(|encoder, write| encoder.start_frame(write));
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // Safety: called after `acquire`, in its critical section.
        let log = unsafe { &mut *LOG.0.get() };
        log.put(|encoder, write| encoder.end_frame(write));
        flush(log.file, &mut log.buffer);
        log.open = false;
        // Safety: the state that `acquire` was given.
        unsafe { critical_section::release(log.restore) };
    }

    unsafe fn write(bytes: &[u8]) {
        // Safety: called after `acquire`, in its critical section.
        let log = unsafe { &mut *LOG.0.get() };
        log.put(|encoder, write| encoder.write(bytes, write));
    }
}

// ------------------------------------------------------------------------------------------------------------- faults

/// Writes what happened and some numbers to the host's fault file and ends the program with a failure.
fn stop(what: &str, numbers: &[u32]) -> ! {
    if let Some(file) = File::open(c"fault", File::WRITE) {
        file.write(what.as_bytes());
        for number in numbers {
            let digits = [28, 24, 20, 16, 12, 8, 4, 0].map(|shift| {
                let digit = (number >> shift & 0xf) as u8;
                digit + if digit < 10 { b'0' } else { b'a' - 10 }
            });
            file.write(b" 0x");
            file.write(&digits);
        }
    }
    exit(Err(()))
}

/// Linked only if something can panic.
#[panic_handler]
#[inline(never)]
fn panic(information: &PanicInfo<'_>) -> ! {
    let (file, line) = information.location().map_or(("?", 0), |location| (location.file(), location.line()));
    if let Some(fault) = File::open(c"fault", File::WRITE) {
        fault.write(b"panic in ");
    }
    stop(file, &[line])
}

unsafe extern "C" {
    static mut _stack_start: u32;
    static mut _stack_end: u32;
}

/// Moves to the top of the stack, which may have overflowed, and reports.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!("ldr r0, =_stack_start", "msr MSP, r0", "b {report}", report = sym report_hard_fault)
}

extern "C" fn report_hard_fault() -> ! {
    // Safety: nothing else runs any more.
    let scb = unsafe { &*SCB::PTR };
    let (status, address) = (scb.cfsr.read(), scb.mmfar.read());
    let guard = stack_bottom()..stack_bottom() + GUARD_BYTES;
    // Bits of the status: stacking failed, or the address is valid.
    let stacking = status & 0x10 != 0;
    if stacking || status & 0x80 != 0 && guard.contains(&(address as usize)) {
        stop("stack overflow", &[status, address]);
    }
    stop("hard fault", &[status, address])
}

fn stack_bottom() -> usize {
    (&raw const _stack_end).addr()
}

fn stack_top() -> usize {
    (&raw const _stack_start).addr()
}

/// Makes the lowest bytes of the stack inaccessible: an overflow is a fault, not silent damage.
fn guard_stack(mpu: &cortex_m::peripheral::MPU) {
    const REGION_VALID: u32 = 1 << 4;
    const EXECUTE_NEVER: u32 = 1 << 28;
    const SIZE_256: u32 = 7 << 1;
    const ENABLE: u32 = 1;
    const DEFAULT_MAP: u32 = 1 << 2;
    // Safety: takes away memory that nothing may use, and nothing else.
    unsafe {
        mpu.rbar.write(stack_bottom() as u32 | REGION_VALID);
        mpu.rasr.write(EXECUTE_NEVER | SIZE_256 | ENABLE);
        mpu.ctrl.write(DEFAULT_MAP | ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Most stack used since power-up, bytes: what is no longer as painted.
fn stack_used() -> usize {
    let mut word = stack_bottom() + GUARD_BYTES;
    while word < stack_top() && Register(word).read() == cortex_m_rt::STACK_PAINT_VALUE {
        word += 4;
    }
    stack_top() - word
}

// -------------------------------------------------------------------------------------------------------------- board

/// The way for messages to the host.
pub struct Telemetry(File);

impl Telemetry {
    /// Sends bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        // The host may have closed the pipe; the run goes on without.
        let _ = self.0.write(bytes);
    }
}

/// What the main loop has of the board.
pub struct Board {
    /// Samples of the data-ready interrupt.
    pub samples: SampleConsumer<'static, Scalar>,
    /// Drives of the outer and the inner axis.
    pub drives: [RateDrive<PipeSpi>; 2],
    /// Calibration records in the EEPROM.
    pub store: CalibrationStore<Eeprom>,
    /// Messages to the host.
    pub telemetry: Telemetry,
    idle_ticks: u64,
}

impl Board {
    /// Sets the board up; data-ready edges begin. Call it once.
    pub fn start() -> Self {
        match Self::new() {
            Some(board) => board,
            None => stop("the host offers no pipes, or the board was started twice", &[]),
        }
    }

    fn new() -> Option<Self> {
        let mut core = cortex_m::Peripherals::take()?;
        guard_stack(&core.MPU);
        CLOCK_TIMER.reload().write(u32::MAX);
        CLOCK_TIMER.control().write(Timer::ENABLE);
        let bus =
            PipeBus { requests: File::open(c"requests", File::WRITE)?, answers: File::open(c"answers", File::READ)? };
        let telemetry = Telemetry(File::open(c"telemetry", File::WRITE)?);
        let spi = |chip| PipeSpi { bus, chip };
        let queue = cortex_m::singleton!(: SampleQueue<Scalar, QUEUE_LENGTH> = SampleQueue::new())?;
        let (producer, samples) = queue.split();
        let imu = Imu::new(spi(Chip::Imu));
        let (outer, inner) = (Encoder::new(spi(Chip::OuterEncoder)), Encoder::new(spi(Chip::InnerEncoder)));
        let acquisition = Acquisition::new(imu, outer, inner, producer);
        critical_section::with(|cs| {
            ACQUISITION.borrow(cs).try_borrow_mut().ok().map(|mut place| *place = Some(acquisition))
        })?;
        start_edges();
        start_waking(&mut core.SYST);
        Some(Self {
            samples,
            drives: [RateDrive::new(spi(Chip::OuterDrive)), RateDrive::new(spi(Chip::InnerDrive))],
            store: CalibrationStore::new(eeprom()),
            telemetry,
            idle_ticks: 0,
        })
    }

    /// Whether the instrument is switched on. Once off, it stays off, and no more samples come.
    pub fn powered(&self) -> bool {
        POWERED.load(Ordering::Relaxed)
    }

    /// Time since power-up, us.
    pub fn now_us(&self) -> u64 {
        ticks() / u64::from(TICKS_PER_S / 1_000_000)
    }

    /// Sleeps until there is something to do, a tenth of a second at most.
    pub fn wait(&mut self) {
        // An interrupt between look and sleep stays pending and ends the sleep.
        critical_section::with(|_| {
            if self.samples.is_empty() && self.powered() {
                let start = ticks();
                cortex_m::asm::wfi();
                self.idle_ticks += ticks() - start;
            }
        });
    }

    /// Reads the configuration the host offers; `None` if there is none, or more than fits in `buffer`.
    pub fn configuration<'a>(&mut self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        let file = File::open(c"configuration", File::READ)?;
        let mut length = 0;
        loop {
            match file.read(buffer.get_mut(length..)?) {
                0 => break,
                count => length += count,
            }
        }
        (0 < length && length < buffer.len()).then_some(buffer.get(..length)?)
    }

    /// Reports on the run and switches off. A failure makes the emulator's exit status 1.
    pub fn finish(self, status: Result<(), ()>) -> ! {
        let (elapsed, stack) = (ticks(), stack_used());
        defmt::info!("stack used: {=usize} bytes of {=usize}", stack, stack_top() - stack_bottom());
        if let Some(file) = File::open(c"run", File::WRITE) {
            file.write(&elapsed.to_le_bytes());
            file.write(&self.idle_ticks.to_le_bytes());
            file.write(&(stack as u64).to_le_bytes());
            file.write(&((stack_top() - stack_bottom()) as u64).to_le_bytes());
            file.write(&u64::from(LATE_EDGES.load(Ordering::Relaxed)).to_le_bytes());
            file.write(&u64::from(self.samples.deepest()).to_le_bytes());
            file.write(&(QUEUE_LENGTH as u64 - 1).to_le_bytes());
            for load in critical_section::with(|cs| LOADS.borrow(cs).get()) {
                file.write(&u64::from(load.spans).to_le_bytes());
                file.write(&load.ticks.to_le_bytes());
                file.write(&u64::from(load.longest).to_le_bytes());
            }
        }
        exit(status)
    }
}

/// Wakes the main loop where no data-ready edge does.
#[cortex_m_rt::exception]
fn SysTick() {}

/// Lets [`SysTick`] come ten times a second.
fn start_waking(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(TICKS_PER_S / 10 - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();
}

fn start_edges() {
    EDGE_TIMER.reload().write(0);
    EDGE_TIMER.control().write(Timer::ENABLE | Timer::ENABLE_INTERRUPT);
    NEXT_EDGE.store(timer_ticks(), Ordering::Relaxed);
    arm_next_edge();
    // Safety: everything the interrupt uses is in place.
    unsafe { NVIC::unmask(DataReady) };
}
