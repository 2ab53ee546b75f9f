//! The registers of the chip: names, access rights, values, and what is wrong with an access.
//!
//! Names, addresses, access rights, fields and clock enables are those of ST's device description, as the crate
//! `stm32-metapac` has them. It has no reset values; those that are not zero and matter are from RM0433.

use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use stm32_metapac::metadata::ir::{Access, Array, BitOffset, Block, BlockItemInner, FieldSet, IR};
use stm32_metapac::metadata::{METADATA, Peripheral};

/// Most values of a register that are kept for the table.
const KEPT_VALUES: usize = 12;

/// Reset values from RM0433 that are not zero. Values of the flash are after the option bytes have been loaded.
const RESET_VALUES: [(&str, u32); 32] = [
    ("TIM1.ARR", 0xffff),
    ("TIM2.ARR", 0xffff_ffff),
    ("TIM3.ARR", 0xffff),
    ("TIM6.ARR", 0xffff),
    ("TIM16.ARR", 0xffff),
    ("GPIOA.MODER", 0xabff_ffff),
    ("GPIOB.MODER", 0xffff_febf),
    ("GPIOC.MODER", 0xffff_ffff),
    ("GPIOD.MODER", 0xffff_ffff),
    ("GPIOE.MODER", 0xffff_ffff),
    ("GPIOF.MODER", 0xffff_ffff),
    ("GPIOG.MODER", 0xffff_ffff),
    ("GPIOH.MODER", 0xffff_ffff),
    ("GPIOI.MODER", 0xffff_ffff),
    ("GPIOJ.MODER", 0xffff_ffff),
    ("GPIOK.MODER", 0xffff_ffff),
    ("GPIOA.PUPDR", 0x6400_0000),
    ("GPIOB.PUPDR", 0x0000_0100),
    ("RCC.CR", 0x0000_0083),
    ("RCC.PLLCKSELR", 0x0202_0200),
    ("RCC.PLLCFGR", 0x01ff_0000),
    ("RCC.PLLDIVR[0]", 0x0101_0280),
    ("RCC.PLLDIVR[1]", 0x0101_0280),
    ("RCC.PLLDIVR[2]", 0x0101_0280),
    ("PWR.CR1", 0xf000_c000),
    ("PWR.CR3", 0x0000_0006),
    ("FLASH.ACR", 0x0000_0037),
    ("FLASH.BANK[0].CR", 0x0000_0031),
    ("FLASH.BANK[1].CR", 0x0000_0031),
    ("IWDG1.RLR", 0x0000_0fff),
    ("SPI1.CFG1", 0x0007_0007),
    ("SPI4.CFG1", 0x0007_0007),
];

struct Known {
    name: String,
    access: Access,
    fields: Option<&'static FieldSet>,
    ir: &'static IR,
    /// Register and bit of RCC that switch the peripheral's clock on.
    clock: Option<(u32, u32)>,
}

/// The use of a register.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Use {
    /// Number of reads.
    pub reads: u64,
    /// Number of writes.
    pub writes: u64,
    /// The first different values that were written, in order.
    pub values: Vec<u32>,
}

/// All registers.
#[derive(Default)]
pub struct Registers {
    known: HashMap<u32, Known>,
    values: HashMap<u32, u32>,
    reset_values: HashMap<u32, u32>,
    uses: HashMap<u32, Use>,
    /// What was wrong, and how often.
    pub violations: BTreeMap<String, u64>,
}

impl Registers {
    /// The registers after power-on.
    pub fn new() -> Self {
        let mut registers = Self::default();
        for peripheral in METADATA.peripherals {
            if let Some(of) = &peripheral.registers {
                let place = Place { name: peripheral.name.to_owned(), address: peripheral.address as u32 };
                registers.add(of.ir, of.block, place);
            }
        }
        let clocks: Vec<_> = METADATA.peripherals.iter().filter_map(clock_enable).collect();
        for known in registers.known.values_mut() {
            let owner = known.name.split('.').next().unwrap_or_default();
            known.clock = clocks.iter().find(|(name, _)| *name == owner).map(|(_, clock)| *clock);
        }
        for (name, value) in RESET_VALUES {
            let found = registers.known.iter().find(|(_, known)| known.name == name);
            registers.reset_values.insert(*found.unwrap_or_else(|| panic!("no register {name}")).0, value);
        }
        registers.reset();
        registers
    }

    fn add(&mut self, ir: &'static IR, block: &str, at: Place) {
        let Some(block) = block_named(ir, block) else { return };
        if let Some(base) = block.extends {
            self.add(ir, base, at.clone());
        }
        for item in block.items {
            for (number, offset) in offsets(item.array.as_ref()) {
                let index = number.map_or_else(String::new, |number| format!("[{number}]"));
                let name = format!("{}.{}{index}", at.name, item.name.to_uppercase());
                let address = at.address + item.byte_offset + offset;
                match &item.inner {
                    BlockItemInner::Block(inner) => self.add(ir, inner.block, Place { name, address }),
                    BlockItemInner::Register(register) => {
                        let fields =
                            register.fieldset.and_then(|name| ir.fieldsets.iter().find(|set| set.name == name));
                        let known = Known { name, access: register.access.clone(), fields, ir, clock: None };
                        // Some blocks give a register a second name for another use.
                        self.known.entry(address).or_insert(known);
                    }
                }
            }
        }
    }

    /// Sets all values as a reset does.
    pub fn reset(&mut self) {
        self.values.clone_from(&self.reset_values);
    }

    /// Sets the value that a register has after each reset.
    pub fn set_after_reset(&mut self, address: u32, value: u32) {
        self.reset_values.insert(address, value);
        self.set(address, value);
    }

    /// The value of a register.
    pub fn get(&self, address: u32) -> u32 {
        self.values.get(&address).copied().unwrap_or(0)
    }

    /// Sets the value of a register.
    pub fn set(&mut self, address: u32, value: u32) {
        self.values.insert(address, value);
    }

    /// Sets or clears bits of a register.
    pub fn set_bits(&mut self, address: u32, bits: u32, on: bool) {
        let value = self.values.entry(address).or_default();
        *value = if on { *value | bits } else { *value & !bits };
    }

    /// Name of a register.
    pub fn name(&self, address: u32) -> String {
        self.known.get(&address).map_or_else(|| super::core::name(address), |known| known.name.clone())
    }

    /// Notes that something is wrong.
    pub fn violate(&mut self, what: String) {
        *self.violations.entry(what).or_default() += 1;
    }

    /// Notes and checks an access of the processor.
    pub fn note(&mut self, address: u32, written: Option<u32>) {
        let usage = self.uses.entry(address).or_default();
        match written {
            None => usage.reads += 1,
            Some(value) => {
                usage.writes += 1;
                if usage.values.len() < KEPT_VALUES && !usage.values.contains(&value) {
                    usage.values.push(value);
                }
            }
        }
        if address >= super::core::START {
            return;
        }
        let wrong = match (self.known.get(&address), written) {
            (None, _) => Some("is not in the device description".to_owned()),
            (Some(Known { access: Access::Read, .. }), Some(_)) => Some("is read-only, but was written".to_owned()),
            (Some(Known { access: Access::Write, .. }), None) => Some("is write-only, but was read".to_owned()),
            (Some(Known { clock: Some((register, bit)), .. }), _) if self.get(*register) >> bit & 1 == 0 => {
                Some("was used without the clock of its peripheral".to_owned())
            }
            _ => None,
        };
        if let Some(wrong) = wrong {
            self.violate(format!("{} {wrong}", self.name(address)));
        }
    }

    /// The registers that were written, by address, with the meaning of the last different value.
    pub fn written(&self) -> Vec<Written> {
        let used = self.uses.iter().filter(|(_, usage)| usage.writes > 0);
        let mut all: Vec<_> = used
            .map(|(address, usage)| Written {
                address: *address,
                name: self.name(*address),
                usage: usage.clone(),
                meaning: usage.values.last().map_or_else(String::new, |value| self.meaning(*address, *value)),
            })
            .collect();
        all.sort_by_key(|written| written.address);
        all
    }

    /// The fields of a value that are not zero, with the names of their values.
    fn meaning(&self, address: u32, value: u32) -> String {
        let Some(Known { fields: Some(set), ir, .. }) = self.known.get(&address) else { return String::new() };
        let mut parts = Vec::new();
        for field in set.fields {
            let BitOffset::Regular(start) = &field.bit_offset else { continue };
            for (number, offset) in offsets(field.array.as_ref()) {
                let mask = u32::MAX >> (32 - field.bit_size.clamp(1, 32));
                let found = value.checked_shr(start.offset + offset).unwrap_or(0) & mask;
                if found == 0 {
                    continue;
                }
                let values = field.enumm.and_then(|name| ir.enums.iter().find(|values| values.name == name));
                let named =
                    values.and_then(|all| all.variants.iter().find(|variant| variant.value == u64::from(found)));
                let index = number.map_or_else(String::new, |number| format!("[{number}]"));
                let shown = named.map_or_else(|| found.to_string(), |variant| variant.name.to_owned());
                parts.push(format!("{}{index}={shown}", field.name));
            }
        }
        parts.join(" ")
    }
}

/// A register that was written.
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Address.
    pub address: u32,
    /// Peripheral and register.
    pub name: String,
    /// Its use.
    #[serde(flatten)]
    pub usage: Use,
    /// Fields of the last different value.
    pub meaning: String,
}

/// A block of registers. The peripherals and the blocks spell its name in different cases.
fn block_named(ir: &'static IR, name: &str) -> Option<&'static Block> {
    let plain = |name: &str| name.replace('_', "").to_lowercase();
    ir.blocks.iter().find(|block| plain(block.name) == plain(name))
}

#[derive(Clone)]
struct Place {
    name: String,
    address: u32,
}

fn offsets(array: Option<&Array>) -> Vec<(Option<u32>, u32)> {
    match array {
        None => vec![(None, 0)],
        Some(Array::Regular(array)) => (0..array.len).map(|number| (Some(number), number * array.stride)).collect(),
        Some(Array::Cursed(array)) => (0..).zip(array.offsets).map(|(number, at)| (Some(number), *at)).collect(),
    }
}

/// The register and the bit that switch the clock of a peripheral on.
fn clock_enable(peripheral: &Peripheral) -> Option<(&'static str, (u32, u32))> {
    let enable = peripheral.rcc.as_ref()?.enable.as_ref()?;
    let rcc = METADATA.peripherals.iter().find(|candidate| candidate.name == "RCC")?;
    let of = rcc.registers.as_ref()?;
    let block = block_named(of.ir, of.block)?;
    let item = block.items.iter().find(|item| item.name.eq_ignore_ascii_case(enable.register))?;
    let BlockItemInner::Register(register) = &item.inner else { return None };
    let set = of.ir.fieldsets.iter().find(|set| Some(set.name) == register.fieldset)?;
    let field = set.fields.iter().find(|field| field.name.eq_ignore_ascii_case(enable.field))?;
    let BitOffset::Regular(bit) = &field.bit_offset else { return None };
    Some((peripheral.name, (rcc.address as u32 + item.byte_offset, bit.offset)))
}
