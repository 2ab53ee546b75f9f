//! The processor: unicorn's Cortex-M7, with the exceptions of ARMv7-M injected from outside, which it does not have.

use crate::bench::Bench;
use crate::chip::flash::{self, Flash};
use crate::chip::{Chip, INTERRUPTS, Reset, core};
use crate::image::Image;
use crate::options::{Options, parse_number};
use crate::report::{Ended, Interrupt, Report};
use anyhow::{Context, Result, anyhow, bail, ensure};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use unicorn_engine::{Arch, ArmCpuModel, HookType, MemType, Mode, Prot, RegisterARM as Register, Unicorn, uc_error};

const PROGRAM: u32 = 0x0800_0000;
const PROGRAM_BYTES: u64 = 0x14_0000;
const STACK_MEMORY: (u64, u64) = (0x2000_0000, 0x2_0000);
const VARIABLES: (u64, u64) = (0x2400_0000, 0x8_0000);
/// The buses of the chip and of the processor: first address and length.
const REGISTERS: [(u64, u64); 6] = [
    (0x4000_0000, 0x3_0000),
    (0x4802_0000, 0x1_0000),
    (0x5200_0000, 0x1_0000),
    (0x5800_0000, 0x3_0000),
    (0x5c00_0000, 0x1_0000),
    (0xe000_0000, 0x10_0000),
];
/// The end of a handler jumps here.
const HANDLER_END: u32 = 0xffff_f000;
/// An endless loop and an undefined instruction, for tests.
const HANG: u32 = 0x1fff_f000;
const UNDEFINED: u32 = HANG + 0x100;
const WFI: [u8; 2] = [0x30, 0xbf];
/// `cpsid i`, and the second half-word of `msr PRIMASK, Rn`. The first one is 0xf380 with the number of the register.
const MASK: u16 = 0xb672;
const SET_MASK: u16 = 0x8810;
/// Value that the start-up code of `cortex-m-rt` writes over the unused stack.
const PAINT: [u8; 4] = [0xcc; 4];
/// Registers that an exception saves, in their order.
const SAVED: [Register; 6] = [Register::R0, Register::R1, Register::R2, Register::R3, Register::R12, Register::LR];
/// Length of the extended frame: eight words, sixteen floating-point registers, FPSCR and one word that is not used.
const FRAME_BYTES: u32 = 104;
/// Wake-ups of the processor between two looks at the log.
const LOOKS: u64 = 64;

/// Marks a loop of `subs rN, #1` and `bne`, which delays.
const COUNTS_DOWN: u8 = 0x80;

/// What the hooks use.
struct State {
    chip: Chip,
    /// Number of instructions of the block at each half-word of the program, zero if it is not known. For a loop that only
    /// counts down, [`COUNTS_DOWN`] and the number of its register.
    lengths: Vec<u8>,
    instructions: u64,
    /// The exception for which unicorn was stopped.
    taken: Option<usize>,
    diversions: Vec<Diversion>,
    /// The address that failed, and the bits of CFSR.
    failed: Option<(u32, u32)>,
    masked_since: Option<u64>,
    longest_masked: (u64, u32),
    guard_page: Option<u64>,
}

/// A place at which the processor continues elsewhere.
struct Diversion {
    from: u32,
    to: u32,
    at_us: f64,
}

/// The machine.
pub struct Machine {
    unicorn: Unicorn<'static, State>,
    rtt: u32,
    stack: (u32, u32),
    serial: Option<Socket>,
    flash_file: Option<PathBuf>,
    reboots: bool,
    longest_us: f64,
    log_unread: bool,
    trace: bool,
}

impl Machine {
    /// The machine before power-on.
    pub fn new(options: &Options, image: &Image) -> Result<Self> {
        let content = options.flash.as_ref().filter(|path| path.exists()).map(std::fs::read).transpose()?;
        let content = content.unwrap_or_default();
        let (bytes, broken) = content.split_at(content.len().min(flash::LENGTH));
        let mut records = Flash::new(bytes.to_vec());
        records.broken.extend(broken.as_chunks::<4>().0.iter().map(|address| u32::from_le_bytes(*address)));
        records.broken.extend(&options.broken);
        (records.rdserr, records.cut_word, records.cut_erase) = (options.rdserr, options.cut_word, options.cut_erase);
        let diversions = options.divert.iter().map(|text| diversion(image, text)).collect::<Result<_>>()?;
        let serial = options.serial.as_deref().map(Socket::listen).transpose()?;
        let mut chip = Chip::new(options, records, Bench::open(&options.directory)?);
        for received in &options.receive {
            // The baud rate is not set up yet; a byte of 921 600 baud takes 10.85 us.
            for (number, byte) in received.bytes.iter().enumerate() {
                chip.serial.arrive(*byte, received.time_us * 480 + number as u64 * 5208);
            }
        }
        let state = State {
            chip,
            lengths: vec![0; PROGRAM_BYTES as usize / 2],
            instructions: 0,
            taken: None,
            diversions,
            failed: None,
            masked_since: None,
            longest_masked: (0, 0),
            guard_page: None,
        };
        let mut unicorn = unicorn(state, image).map_err(|error| anyhow!("unicorn: {error:?}"))?;
        for piece in &image.pieces {
            unicorn.mem_write(piece.address.into(), &piece.bytes).map_err(|_| anyhow!("the image does not fit"))?;
        }
        let stack = (image.symbol("_stack_end")?, image.symbol("_stack_start")?);
        Ok(Self {
            unicorn,
            rtt: image.symbol("_SEGGER_RTT")?,
            stack,
            serial,
            flash_file: options.flash.clone(),
            reboots: options.reboots,
            longest_us: options.longest_s * 1e6,
            log_unread: options.log_unread,
            trace: options.trace,
        })
    }

    fn state(&mut self) -> &mut State {
        self.unicorn.get_data_mut()
    }

    fn vector(&self, number: usize) -> u32 {
        self.word(PROGRAM + 4 * number as u32)
    }

    fn word(&self, address: u32) -> u32 {
        let mut word = [0; 4];
        // An address outside of the memory reads as zero.
        let _ = self.unicorn.mem_read(address.into(), &mut word);
        u32::from_le_bytes(word)
    }

    fn register(&self, register: Register) -> u32 {
        self.unicorn.reg_read(register).unwrap_or(0) as u32
    }

    fn set(&mut self, register: Register, value: u32) {
        self.unicorn.reg_write(register, value.into()).expect("a register of the processor");
    }

    /// Runs the image until the run ends.
    pub fn run(&mut self) -> Result<Ended> {
        let mut pc = self.power_on();
        let mut wakes = 0_u64;
        let ended = loop {
            let outcome = self.unicorn.emu_start(u64::from(pc | 1), HANDLER_END.into(), 0, 0);
            pc = self.unicorn.pc_read().unwrap_or(0) as u32;
            if let Some(error) = self.state().chip.failure.take() {
                // The host has ended, or has cut the power.
                self.keep_flash()?;
                return Err(error);
            }
            if self.state().chip.flash.cut {
                break Ended::PowerCut;
            }
            if let Some(cause) = self.state().chip.reset {
                self.look(true)?;
                if !self.reboots {
                    break Ended::Reset;
                }
                pc = self.restart(cause);
                continue;
            }
            if pc & !0xfff == HANDLER_END & !0xfff {
                pc = self.leave();
                continue;
            }
            if let Some((address, status)) = self.failure(outcome, pc)? {
                self.fail(address, status);
                pc = self.enter(core::HARD_FAULT, pc);
                continue;
            }
            if let Some(at) = self.state().diversions.iter().position(|diversion| diversion.from == pc)
                && self.state().chip.us() >= self.state().diversions[at].at_us
            {
                pc = self.state().diversions.remove(at).to;
                continue;
            }
            if let Some(line) = self.state().taken.take() {
                pc = self.enter(line, pc);
                continue;
            }
            let mut before = [0; 2];
            let _ = self.unicorn.mem_read(u64::from(pc) - 2, &mut before);
            ensure!(before == WFI, "the processor stopped at {pc:#x} for no known reason");
            wakes += 1;
            if !self.state().chip.sleep() {
                break Ended::SleepsForEver;
            }
            // The main loop sleeps with interrupts masked, and is woken by them all the same.
            let state = self.state();
            state.masked_since = state.masked_since.map(|_| state.chip.now);
            self.look(wakes.is_multiple_of(LOOKS))?;
            if !self.state().chip.powered {
                break Ended::SwitchedOff;
            }
            if self.state().chip.us() > self.longest_us {
                break Ended::TimeOver;
            }
        };
        self.look(true)?;
        self.keep_flash()?;
        Ok(ended)
    }

    fn power_on(&mut self) -> u32 {
        self.set(Register::SP, self.vector(0));
        self.vector(1)
    }

    fn restart(&mut self, cause: Reset) -> u32 {
        self.state().chip.reset_by(cause);
        let state = self.state();
        (state.taken, state.failed, state.masked_since) = (None, None, None);
        if let Some(page) = state.guard_page.take() {
            self.unicorn.mem_protect(page, 0x1000, Prot::READ | Prot::WRITE).expect("the page is mapped");
        }
        self.set(Register::PRIMASK, 0);
        self.set(Register::FAULTMASK, 0);
        self.power_on()
    }

    /// The address and the status of a fault, if unicorn has stopped for one.
    fn failure(&mut self, outcome: Result<(), uc_error>, pc: u32) -> Result<Option<(u32, u32)>> {
        const DATA_ACCESS: u32 = 0x82;
        const BUS_ERROR: u32 = 0x8200;
        const UNDEFINED_INSTRUCTION: u32 = 1 << 16;
        let state = self.state();
        if let Some((address, by_mpu)) = state.chip.fault.take() {
            return Ok(Some((address, if by_mpu { DATA_ACCESS } else { BUS_ERROR })));
        }
        Ok(match (state.failed.take(), outcome) {
            (Some(failed), _) => Some(failed),
            (None, Ok(())) => None,
            (None, Err(uc_error::INSN_INVALID | uc_error::EXCEPTION)) => Some((pc, UNDEFINED_INSTRUCTION)),
            (None, Err(error)) => bail!("unicorn stopped at {pc:#x}: {error:?}"),
        })
    }

    fn fail(&mut self, address: u32, status: u32) {
        let registers = &mut self.state().chip.registers;
        registers.set(core::CFSR, status);
        registers.set(core::MMFAR, address);
        registers.set(core::BFAR, address);
    }

    /// Begins the handler of an exception: saves the registers on the stack.
    fn enter(&mut self, line: usize, pc: u32) -> u32 {
        let (sp, status) = (self.register(Register::SP), self.register(Register::XPSR));
        let frame = (sp - FRAME_BYTES) & !7;
        let padded = u32::from(sp & 4 != 0) << 9;
        let mut words: Vec<u32> = SAVED.iter().map(|register| self.register(*register)).collect();
        let running = self.state().chip.core.running() as u32;
        words.extend([pc & !1, status & !0x3ff | padded | running]);
        words.extend((0..16).map(|number| self.unicorn.reg_read(Register::S0 as i32 + number).unwrap_or(0) as u32));
        words.extend([self.register(Register::FPSCR), 0]);
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let forbidden = self.state().chip.core.forbids(frame, true);
        if forbidden || self.unicorn.mem_write(frame.into(), &bytes).is_err() {
            // Saving the registers fails: MSTKERR.
            self.fail(frame, 1 << 4);
        }
        self.set(Register::SP, frame);
        let state = self.state();
        state.taken = None;
        let link = state.chip.core.enter(line, state.chip.now);
        self.set(Register::LR, link);
        self.set(Register::XPSR, 0x0100_0000 | line as u32);
        self.vector(line)
    }

    /// Ends a handler: takes the registers from the stack.
    fn leave(&mut self) -> u32 {
        let frame = self.register(Register::SP);
        let words: Vec<u32> = (0..FRAME_BYTES / 4).map(|number| self.word(frame + 4 * number)).collect();
        for (register, word) in SAVED.iter().zip(&words) {
            self.set(*register, *word);
        }
        for (number, word) in words[8..24].iter().enumerate() {
            self.unicorn.reg_write(Register::S0 as i32 + number as i32, u64::from(*word)).expect("a register");
        }
        self.set(Register::FPSCR, words[24]);
        self.set(Register::XPSR, words[7] & !0x3ff | 0x0100_0000);
        self.set(Register::SP, frame + FRAME_BYTES + (words[7] >> 9 & 1) * 4);
        let state = self.state();
        state.taken = None;
        state.chip.core.leave(state.chip.now);
        state.chip.lines();
        words[6]
    }

    /// Moves bytes between the chip and the host; `at_log` says whether to look at the log too.
    fn look(&mut self, at_log: bool) -> Result<()> {
        let sent = self.state().chip.drain_serial()?;
        if let Some(socket) = &mut self.serial {
            socket.send(&sent);
            let received = socket.receive();
            let chip = &mut self.unicorn.get_data_mut().chip;
            chip.serial.arrive_all(&chip.registers, &received, chip.now);
        }
        if at_log {
            self.look_at_log()?;
        }
        Ok(())
    }

    /// Reads the log's ring buffer, as a probe does. Its control block is that of RTT.
    fn look_at_log(&mut self) -> Result<()> {
        const BUFFER: u32 = 24 + 4;
        const BLOCKING: u32 = 2;
        let [buffer, size, write, read] = [0, 1, 2, 3].map(|number| self.word(self.rtt + BUFFER + 4 * number));
        if self.log_unread {
            // The probe has switched the log to blocking and has gone away. No byte is free any more.
            let full = if size == 0 { 0 } else { (write + 1) % size };
            let place = self.rtt + BUFFER + 12;
            self.unicorn.mem_write(place.into(), &full.to_le_bytes()).map_err(|_| anyhow!("no log"))?;
            let flags = self.rtt + BUFFER + 16;
            self.unicorn.mem_write(flags.into(), &BLOCKING.to_le_bytes()).map_err(|_| anyhow!("no log"))?;
            return Ok(());
        }
        if write == read || size == 0 || write >= size || read >= size {
            return Ok(());
        }
        let ring = self.unicorn.mem_read_as_vec(buffer.into(), size as usize).map_err(|_| anyhow!("no log"))?;
        let (read_at, write_at) = (read as usize, write as usize);
        let bytes = if write > read {
            ring[read_at..write_at].to_vec()
        } else {
            [&ring[read_at..], &ring[..write_at]].concat()
        };
        let place = self.rtt + BUFFER + 12;
        self.unicorn.mem_write(place.into(), &write.to_le_bytes()).map_err(|_| anyhow!("no log"))?;
        self.state().chip.log(&bytes)
    }

    fn keep_flash(&mut self) -> Result<()> {
        let Some(path) = self.flash_file.clone() else { return Ok(()) };
        let flash = &self.state().chip.flash;
        let broken = flash.broken.iter().flat_map(|address| address.to_le_bytes());
        let content: Vec<u8> = flash.bytes.iter().copied().chain(broken).collect();
        std::fs::write(&path, content).with_context(|| path.display().to_string())
    }

    fn stack_used(&self) -> u64 {
        let (bottom, top) = (u64::from(self.stack.0), u64::from(self.stack.1));
        const GUARD: u64 = 256;
        let words = self.unicorn.mem_read_as_vec(bottom + GUARD, (top - bottom - GUARD) as usize).unwrap_or_default();
        let unused = words.as_chunks::<4>().0.iter().take_while(|word| **word == PAINT).count() as u64 * 4;
        top - bottom - GUARD - unused
    }

    /// The figures of the run.
    pub fn report(&mut self, ended: Ended) -> Result<Report> {
        let (stack_used_bytes, stack, trace) = (self.stack_used(), self.stack, self.trace);
        let state = self.state();
        let us = |cycles: u64| cycles as f64 / 480.0;
        let chip = &mut state.chip;
        let interrupts = INTERRUPTS.iter().map(|(name, line)| {
            let statistics = chip.core.statistics[*line];
            Interrupt {
                name,
                taken: statistics.taken,
                longest_wait_us: us(statistics.longest_wait),
                longest_run_us: us(statistics.longest_run),
            }
        });
        Ok(Report {
            ended,
            elapsed_us: us(chip.now),
            idle: chip.idle as f64 / chip.now.max(1) as f64,
            instructions: state.instructions,
            stack_used_bytes,
            stack_bytes: (stack.1 - stack.0).into(),
            resets: chip.resets,
            late_periods: chip.late_periods(),
            watchdog_started_us: chip.watchdog_started_us(),
            interrupts: interrupts.collect(),
            deepest_nesting: chip.core.deepest,
            longest_masked_us: us(state.longest_masked.0),
            masked_until: state.longest_masked.1,
            overruns: [chip.serial.lost, chip.imu_line.lost],
            closed: chip.core.forbidden().map(|range| [range.start, range.end]).collect(),
            violations: std::mem::take(&mut chip.registers.violations),
            flash_changes: std::mem::take(&mut chip.flash.changes),
            registers: if trace { chip.registers.written() } else { Vec::new() },
            pins: if trace { chip.pins() } else { Vec::new() },
        })
    }
}

fn diversion(image: &Image, text: &str) -> Result<Diversion> {
    let mut parts = text.split(':');
    let mut part = || parts.next().with_context(|| format!("{text} is not FROM:TO:US"));
    let place = |name: &str| match name {
        "hang" => Ok(HANG),
        "fault" => Ok(UNDEFINED),
        _ => parse_number(name).or_else(|_| image.symbol(name)),
    };
    Ok(Diversion { from: place(part()?)?, to: place(part()?)?, at_us: part()?.parse()? })
}

/// The processor with its memory and its hooks.
fn unicorn(state: State, image: &Image) -> Result<Unicorn<'static, State>, uc_error> {
    let mut unicorn = Unicorn::new_with_data(Arch::ARM, Mode::THUMB, state)?;
    // The mode for microcontrollers would select a Cortex-M33, without double precision.
    unicorn.ctl_set_cpu_model(ArmCpuModel::CORTEX_M7 as i32)?;
    unicorn.mem_map(PROGRAM.into(), PROGRAM_BYTES, Prot::READ | Prot::EXEC)?;
    for (start, length) in [STACK_MEMORY, VARIABLES] {
        unicorn.mem_map(start, length, Prot::READ | Prot::WRITE)?;
    }
    unicorn.mem_map((HANDLER_END & !0xfff).into(), 0x1000, Prot::ALL)?;
    unicorn.mem_map(HANG.into(), 0x1000, Prot::READ | Prot::EXEC)?;
    // It sleeps between two interrupts, so that it takes no time of the host.
    unicorn.mem_write(HANG.into(), &[0x30, 0xbf, 0xfd, 0xe7])?;
    unicorn.mem_write(UNDEFINED.into(), &[0x00, 0xde])?;
    for (start, length) in REGISTERS {
        let base = start as u32;
        unicorn.mmio_map(
            start,
            length,
            Some(move |unicorn: &mut Unicorn<State>, offset: u64, size: usize| {
                u64::from(unicorn.get_data_mut().chip.read(base + offset as u32, size))
            }),
            Some(move |unicorn: &mut Unicorn<State>, offset: u64, size: usize, value: u64| {
                unicorn.get_data_mut().chip.write(base + offset as u32, size, value as u32);
                follow(unicorn);
            }),
        )?;
    }
    unicorn.mmio_map(
        flash::RECORDS.into(),
        flash::LENGTH as u64,
        Some(|unicorn: &mut Unicorn<State>, offset: u64, size: usize| {
            let value = unicorn.get_data_mut().chip.read_flash(flash::RECORDS + offset as u32, size);
            follow(unicorn);
            value
        }),
        Some(|unicorn: &mut Unicorn<State>, offset: u64, size: usize, value: u64| {
            unicorn.get_data_mut().chip.write_flash(flash::RECORDS + offset as u32, size, value);
            follow(unicorn);
        }),
    )?;
    unicorn.add_block_hook(1, 0, on_block)?;
    unicorn.add_mem_hook(HookType::MEM_INVALID, 1, 0, on_bad_access)?;
    for place in image.halfwords(MASK).map(u64::from) {
        unicorn.add_code_hook(place, place, |unicorn: &mut Unicorn<State>, pc, _| note_mask(unicorn, true, pc))?;
    }
    for place in image.halfwords(SET_MASK).map(|second| u64::from(second - 2)) {
        unicorn.add_code_hook(place, place, |unicorn: &mut Unicorn<State>, pc, _| {
            let mut first = [0; 2];
            let _ = unicorn.mem_read(pc, &mut first);
            let source = i32::from(first[0] & 0xf) + Register::R0 as i32;
            if first[1] == 0xf3 && first[0] & 0xf0 == 0x80 {
                let masks = unicorn.reg_read(source).unwrap_or(0) & 1 == 1;
                note_mask(unicorn, masks, pc);
            }
        })?;
    }
    Ok(unicorn)
}

/// Stops unicorn where the chip has something to say, and protects the guard of the stack as the MPU does.
fn follow(unicorn: &mut Unicorn<State>) {
    let state = unicorn.get_data_mut();
    let chip = &state.chip;
    let stops = chip.fault.is_some() || chip.reset.is_some() || chip.failure.is_some() || chip.flash.cut;
    let memory = STACK_MEMORY.0..STACK_MEMORY.0 + STACK_MEMORY.1;
    let guard = chip.core.forbidden().find(|range| memory.contains(&range.start)).map(|range| range.start & !0xfff);
    if state.guard_page.is_none()
        && let Some(page) = guard
    {
        state.guard_page = Some(page);
        let _ = unicorn.mem_protect(page, 0x1000, Prot::NONE);
    }
    if stops {
        let _ = unicorn.emu_stop();
    }
}

/// Before each block of instructions: counts, lets time pass, and stops for an exception.
fn on_block(unicorn: &mut Unicorn<State>, pc: u64, size: u32) {
    let count = instructions(unicorn, pc as u32, size);
    let state = unicorn.get_data_mut();
    state.instructions += count;
    state.chip.now += count;
    if state.chip.now >= state.chip.next {
        state.chip.advance();
    }
    let chip = &state.chip;
    let diverts = |diversion: &Diversion| u64::from(diversion.from) == pc && chip.us() >= diversion.at_us;
    if chip.reset.is_some() || chip.failure.is_some() || state.diversions.iter().any(diverts) {
        let _ = unicorn.emu_stop();
        return;
    }
    if !chip.core.check {
        return;
    }
    match chip.core.next() {
        None => state.chip.core.check = state.chip.core.any_pending(),
        Some(line) => {
            let masked = |register| unicorn.reg_read(register).unwrap_or(0) & 1 == 1;
            if !masked(Register::PRIMASK) && !masked(Register::FAULTMASK) {
                unicorn.get_data_mut().taken = Some(line);
                let _ = unicorn.emu_stop();
            }
        }
    }
}

/// Number of instructions in a block. An instruction whose first half-word begins with 0b11101, 0b11110 or 0b11111 has
/// two half-words.
fn instructions(unicorn: &mut Unicorn<State>, pc: u32, size: u32) -> u64 {
    let place = (pc.wrapping_sub(PROGRAM) / 2) as usize;
    match unicorn.get_data().lengths.get(place) {
        None => return u64::from(size / 4).max(1),
        Some(0) => {}
        Some(marked) if marked & COUNTS_DOWN != 0 => return count_down(unicorn, marked & 7),
        Some(count) => return (*count).into(),
    }
    let mut bytes = vec![0; size as usize];
    let _ = unicorn.mem_read(pc.into(), &mut bytes);
    if let [1, subtract, 0xfd, 0xd1] = *bytes
        && subtract & 0xf8 == 0x38
    {
        unicorn.get_data_mut().lengths[place] = COUNTS_DOWN | subtract & 7;
        return count_down(unicorn, subtract & 7);
    }
    let (mut at, mut count) = (0, 0_u8);
    while let Some([low, high]) = bytes.get(at..at + 2) {
        let is_long = u16::from_le_bytes([*low, *high]) >> 11 >= 0b11101;
        at += if is_long { 4 } else { 2 };
        count = (count + 1).min(COUNTS_DOWN - 1);
    }
    unicorn.get_data_mut().lengths[place] = count.max(1);
    count.max(1).into()
}

/// A turn of a loop that delays. Skips the turns until the next event.
fn count_down(unicorn: &mut Unicorn<State>, register: u8) -> u64 {
    // The Cortex-M7 runs both instructions of a turn in one cycle at best, so that no delay is shorter on silicon.
    const TURN: u64 = 1;
    let chip = &unicorn.get_data().chip;
    let register = Register::R0 as i32 + i32::from(register);
    let left = unicorn.reg_read(register).unwrap_or(0);
    let turns = (chip.next.saturating_sub(chip.now) / TURN).min(left.saturating_sub(1));
    let _ = unicorn.reg_write(register, left - turns);
    TURN * (turns + 1)
}

/// An access outside of the memory, or to the guard of the stack. The result is whether the access is repeated.
fn on_bad_access(unicorn: &mut Unicorn<State>, kind: MemType, address: u64, _size: usize, _value: i64) -> bool {
    const BUS_ERROR: u32 = 0x8200;
    const DATA_ACCESS: u32 = 0x82;
    const INSTRUCTION: u32 = 1 << 8;
    let writes = matches!(kind, MemType::WRITE_PROT | MemType::WRITE_UNMAPPED);
    let state = unicorn.get_data_mut();
    let forbidden = state.chip.core.forbids(address as u32, writes);
    if !forbidden && state.guard_page == Some(address & !0xfff) {
        // The page has more than the guard. From now on, the guard is not watched.
        let _ = unicorn.mem_protect(address & !0xfff, 0x1000, Prot::READ | Prot::WRITE);
        return true;
    }
    let status = match kind {
        MemType::FETCH_UNMAPPED | MemType::FETCH_PROT => INSTRUCTION,
        _ if forbidden => DATA_ACCESS,
        _ => BUS_ERROR,
    };
    if status != INSTRUCTION || (address as u32) < HANDLER_END {
        if !forbidden {
            state.chip.registers.violate(format!("an access outside of the memory, at {address:#x}"));
        }
        state.failed = Some((address as u32, status));
    }
    false
}

fn note_mask(unicorn: &mut Unicorn<State>, masks: bool, pc: u64) {
    let was_masked = unicorn.reg_read(Register::PRIMASK).unwrap_or(0) & 1 == 1;
    let state = unicorn.get_data_mut();
    if masks && !was_masked {
        state.masked_since = Some(state.chip.now);
    } else if !masks && let Some(since) = state.masked_since.take() {
        state.longest_masked = state.longest_masked.max((state.chip.now - since, pc as u32));
    }
}

/// The other end of the serial line, if it is offered at a socket.
struct Socket {
    listener: UnixListener,
    stream: Option<UnixStream>,
    waiting: VecDeque<u8>,
}

impl Socket {
    fn listen(path: &std::path::Path) -> Result<Self> {
        let listener = UnixListener::bind(path).with_context(|| path.display().to_string())?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, stream: None, waiting: VecDeque::new() })
    }

    fn send(&mut self, bytes: &[u8]) {
        if self.stream.is_none()
            && let Ok((stream, _)) = self.listener.accept()
            && stream.set_nonblocking(true).is_ok()
        {
            self.stream = Some(stream);
        }
        let Some(stream) = &mut self.stream else { return };
        self.waiting.extend(bytes);
        match stream.write(self.waiting.make_contiguous()) {
            Ok(count) => drop(self.waiting.drain(..count)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => self.hang_up(),
        }
    }

    fn receive(&mut self) -> Vec<u8> {
        let mut bytes = [0; 4096];
        let Some(stream) = &mut self.stream else { return Vec::new() };
        match stream.read(&mut bytes) {
            Ok(0) => self.hang_up(),
            Ok(count) => return bytes[..count].to_vec(),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => self.hang_up(),
        }
        Vec::new()
    }

    fn hang_up(&mut self) {
        self.stream = None;
        self.waiting.clear();
    }
}
