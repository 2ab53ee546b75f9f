//! Golden bytes: the encoding of stored and transmitted values, pinned so that nobody changes a format unawares.

use core::fmt::Debug;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Longest encoding that a table gives as it is, bytes. A longer one is given by its length and its CRC-32.
const LONGEST_BYTES: usize = 32;

/// A row of a table: whether the value matches the pattern of its row, the value, and what is pinned of it.
pub(crate) type Row<T> = (bool, T, &'static str);

/// A table with a row for each variant: a pattern, a value that matches it, and what is pinned of the value. The patterns
/// make a `match` without `_`: a new variant that has no row does not compile.
macro_rules! table {
    ($type:ty: $($pattern:pat => $value:expr, $pinned:literal;)*) => {{
        let _every_variant_has_a_row = |value: &$type| match value {
            $($pattern => (),)*
        };
        let rows: std::vec::Vec<$crate::base::golden::Row<$type>> = std::vec![$({
            let value: $type = $value;
            (matches!(&value, $pattern), value, $pinned)
        }),*];
        rows
    }};
}
pub(crate) use table;

/// Checks that the values of a table are encoded as pinned, and decoded to what they were.
///
/// # Panics
/// A row is wrong; the message has all wrong rows, with what they should be.
pub(crate) fn check_bytes<T: Serialize + DeserializeOwned + PartialEq + Debug>(rows: Vec<Row<T>>) {
    let mut wrong = String::new();
    for (matches, value, pinned) in rows {
        assert!(matches, "this value is in the row of another variant: {value:?}");
        let mut buffer = [0; 2048];
        let bytes = postcard::to_slice(&value, &mut buffer).expect("it fits");
        assert_eq!(postcard::from_bytes::<T>(bytes).as_ref(), Ok(&value));
        let found = in_short(bytes);
        if found != pinned {
            wrong += &format!("\n{pinned:?} is now {found:?}: {:.60}", format!("{value:?}"));
        }
    }
    assert!(wrong.is_empty(), "the encoding has changed, so its version must be counted up:{wrong}");
}

fn in_short(bytes: &[u8]) -> String {
    if bytes.len() > LONGEST_BYTES {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes);
        return format!("{} bytes, CRC {crc:08x}", bytes.len());
    }
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}
