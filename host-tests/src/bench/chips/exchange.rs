//! A transaction on SPI from the chip's side.

use embedded_hal::spi::Operation;

/// One transaction with a chip. The chip gets all bytes of the operations in one buffer and answers in it.
pub fn exchange(operations: &mut [Operation<'_, u8>], chip: impl FnOnce(&mut [u8])) {
    let mut bytes = Vec::new();
    for operation in operations.iter() {
        match operation {
            Operation::Read(received) => bytes.resize(bytes.len() + received.len(), 0),
            Operation::Write(sent) => bytes.extend_from_slice(sent),
            Operation::TransferInPlace(both) => bytes.extend_from_slice(both),
            Operation::Transfer(received, sent) => {
                bytes.extend_from_slice(sent);
                bytes.resize(bytes.len() + received.len().saturating_sub(sent.len()), 0);
            }
            Operation::DelayNs(_) => {}
        }
    }
    chip(&mut bytes);
    let mut rest = bytes.as_slice();
    for operation in operations {
        let length = match operation {
            Operation::Read(both) | Operation::TransferInPlace(both) => {
                both.copy_from_slice(&rest[..both.len()]);
                both.len()
            }
            Operation::Transfer(received, sent) => {
                received.copy_from_slice(&rest[..received.len()]);
                received.len().max(sent.len())
            }
            Operation::Write(sent) => sent.len(),
            Operation::DelayNs(_) => 0,
        };
        rest = &rest[length..];
    }
}
