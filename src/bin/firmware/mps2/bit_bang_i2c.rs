//! I2C master on two open-drain pins.

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress};

/// Half a clock period at 400 kHz, ns.
const HALF_PERIOD_NS: u32 = 1250;

/// The fault of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The device did not acknowledge its address or a byte.
    NoAcknowledge(NoAcknowledgeSource),
    /// A pin does not work.
    Pin,
}

impl Error for Fault {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NoAcknowledge(source) => ErrorKind::NoAcknowledge(*source),
            Self::Pin => ErrorKind::Bus,
        }
    }
}

/// The I2C bus.
pub struct BitBangI2c<Scl, Sda, D> {
    scl: Scl,
    sda: Sda,
    delay: D,
}

impl<Scl: OutputPin, Sda: OutputPin + InputPin, D: DelayNs> BitBangI2c<Scl, Sda, D> {
    /// The bus on two open-drain pins with pull-ups.
    pub fn new(scl: Scl, sda: Sda, delay: D) -> Self {
        Self { scl, sda, delay }
    }

    fn clock(&mut self, high: bool) -> Result<(), Fault> {
        self.delay.delay_ns(HALF_PERIOD_NS);
        self.scl.set_state(high.into()).map_err(|_| Fault::Pin)
    }

    fn data(&mut self, high: bool) -> Result<(), Fault> {
        self.sda.set_state(high.into()).map_err(|_| Fault::Pin)
    }

    /// Sends a start or a repeated start.
    fn start(&mut self) -> Result<(), Fault> {
        self.data(true)?;
        self.clock(true)?;
        self.data(false)?;
        self.clock(false)
    }

    fn stop(&mut self) -> Result<(), Fault> {
        self.data(false)?;
        self.clock(true)?;
        self.delay.delay_ns(HALF_PERIOD_NS);
        self.data(true)
    }

    fn write_bit(&mut self, bit: bool) -> Result<(), Fault> {
        self.data(bit)?;
        self.clock(true)?;
        self.clock(false)
    }

    fn read_bit(&mut self) -> Result<bool, Fault> {
        self.data(true)?;
        self.clock(true)?;
        let bit = self.sda.is_high().map_err(|_| Fault::Pin)?;
        self.clock(false)?;
        Ok(bit)
    }

    fn write_byte(&mut self, byte: u8, source: NoAcknowledgeSource) -> Result<(), Fault> {
        for bit in (0..8).rev() {
            self.write_bit(byte >> bit & 1 == 1)?;
        }
        if self.read_bit()? { Err(Fault::NoAcknowledge(source)) } else { Ok(()) }
    }

    fn read_byte(&mut self, acknowledge: bool) -> Result<u8, Fault> {
        let mut byte = 0;
        for _ in 0..8 {
            byte = byte << 1 | u8::from(self.read_bit()?);
        }
        self.write_bit(!acknowledge)?;
        Ok(byte)
    }

    fn run(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Fault> {
        // Consecutive operations in one direction form one transfer.
        let mut reading = None;
        let mut rest = operations.iter_mut().peekable();
        while let Some(operation) = rest.next() {
            let read = matches!(operation, Operation::Read(_));
            if reading != Some(read) {
                self.start()?;
                self.write_byte(address << 1 | u8::from(read), NoAcknowledgeSource::Address)?;
                reading = Some(read);
            }
            match operation {
                Operation::Write(bytes) => {
                    for byte in bytes.iter() {
                        self.write_byte(*byte, NoAcknowledgeSource::Data)?;
                    }
                }
                Operation::Read(bytes) => {
                    let more = matches!(rest.peek(), Some(Operation::Read(_)));
                    let last = bytes.len().saturating_sub(1);
                    for (index, byte) in bytes.iter_mut().enumerate() {
                        *byte = self.read_byte(more || index < last)?;
                    }
                }
            }
        }
        Ok(())
    }
}

impl<Scl, Sda, D> ErrorType for BitBangI2c<Scl, Sda, D> {
    type Error = Fault;
}

impl<Scl: OutputPin, Sda: OutputPin + InputPin, D: DelayNs> I2c<SevenBitAddress> for BitBangI2c<Scl, Sda, D> {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Fault> {
        let outcome = self.run(address, operations);
        self.stop()?;
        outcome
    }
}
