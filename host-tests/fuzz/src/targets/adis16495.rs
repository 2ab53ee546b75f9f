//! The burst of an ADIS16495.

use crate::reference::crc_32;
use crate::source::Source;
use crate::target::{Claim, Outcome, Target, digest};
use rins_selfcal::drivers::ImuFault;
use rins_selfcal::drivers::adis16495::{self, BURST_BYTES};
use std::convert::Infallible;

/// Words after the opening and before the CRC.
const WORDS: usize = 15;
const ID: u16 = 0xa5a5;

/// A burst.
pub struct Burst;

impl Target for Burst {
    fn name(&self) -> &'static str {
        "adis16495"
    }

    fn moment(&self) -> u64 {
        50_000
    }

    fn make(&self, source: &mut Source, input: &mut Vec<u8>) -> Claim {
        let mut words = [0; WORDS];
        words.fill_with(|| source.bits() as u16);
        words[0] &= *source.pick(&[0, 0x81ee, 0xffff]);
        let opening = *source.pick(&[1, 2]);
        input.extend(burst(words, opening, source.bits() as u16));
        let content = 2 * (1 + opening);
        match source.below(4) {
            0 if words[0] != ID => Claim::Value(digest(words)),
            1 if words[0] != ID => {
                // A CRC-32 detects any five wrong bits in 268 bits or fewer.
                let count = 1 + source.below(5);
                source.flip(&mut input[content..content + 2 * (WORDS + 2)], count);
                Claim::Refused
            }
            2 => {
                *input = source.noise(BURST_BYTES + 1);
                input.resize(BURST_BYTES, source.byte());
                Claim::Nothing
            }
            _ => {
                source.damage(input);
                input.resize(BURST_BYTES, source.byte());
                Claim::Nothing
            }
        }
    }

    fn judge(&self, input: &[u8]) -> Outcome {
        let Ok(burst) = input.try_into() else { return Outcome::refused("nothing") };
        let decoded = adis16495::Burst::decode::<Infallible>(burst);
        let words: Vec<u16> = burst.as_chunks::<2>().0.iter().map(|word| u16::from_be_bytes(*word)).collect();
        // The content follows the first one, two or three words. The last of these words is the identification, and the
        // next word is not.
        let content = words.windows(WORDS + 3).find(|window| window[0] == ID && window[1] != ID);
        let Some((content, crc)) = content.and_then(|window| window[1..].split_at_checked(WORDS)) else {
            assert_eq!(decoded, Err(ImuFault::NoAnswer));
            return Outcome::refused("no-answer");
        };
        let low_first: Vec<u8> = content.iter().flat_map(|word| word.to_le_bytes()).collect();
        if crc_32(&low_first).to_le_bytes() != [crc[0].to_le_bytes(), crc[1].to_le_bytes()].concat()[..] {
            assert_eq!(decoded, Err(ImuFault::Crc));
            return Outcome::refused("crc");
        }
        let long = |at: usize| (u32::from(content[at + 1]) << 16 | u32::from(content[at])).cast_signed();
        let expected = adis16495::Burst {
            flags: content[0],
            temperature: content[1].cast_signed(),
            gyro: [2, 4, 6].map(long),
            accel: [8, 10, 12].map(long),
            count: content[14],
        };
        assert_eq!(decoded, Ok(expected));
        let words: [u16; WORDS] = content.try_into().expect("WORDS words");
        Outcome::accepted(if words[0] == 0 { "burst" } else { "burst-with-flags" }, words)
    }
}

/// A burst with one or two opening words, after a word without meaning.
fn burst(words: [u16; WORDS], opening: usize, before: u16) -> Vec<u8> {
    let low_first: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let crc = crc_32(&low_first);
    let head = std::iter::once(before).chain(std::iter::repeat_n(ID, opening));
    let all = head.chain(words).chain([crc as u16, (crc >> 16) as u16]);
    let mut bytes: Vec<u8> = all.flat_map(u16::to_be_bytes).collect();
    bytes.resize(BURST_BYTES, 0);
    bytes
}
