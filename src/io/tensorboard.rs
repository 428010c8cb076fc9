//! TensorBoard event files: scalars by step.
//!
//! The format (TensorFlow's tfevents): records of length (u64), masked CRC-32C of the length, data, masked CRC-32C of the
//! data, all little-endian; data are protocol buffers `Event { wall_time: double = 1, step: int64 = 2, file_version:
//! string = 3, summary: Summary = 5 }`, `Summary { value: repeated Value = 1 }`, `Value { tag: string = 1, simple_value:
//! float = 2 }`. The crate that writes them drags in protobuf 2, for these fifty lines.

use super::FileError;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A file that grows by one record per call.
pub struct EventFile {
    path: PathBuf,
    file: File,
}

impl EventFile {
    /// A new event file in a folder; earlier ones stay, TensorBoard reads them all.
    pub fn create(folder: &Path) -> Result<Self, FileError> {
        let now = seconds();
        let path =
            folder.join(format!("events.out.tfevents.{:010}.{:09}.hydrograd", now as u64, (now.fract() * 1e9) as u64));
        let file = File::create(&path).map_err(|source| FileError::write(&path, source))?;
        let mut events = Self { path, file };
        events.record(now, &bytes(3, b"brain.Event:2"))?;
        Ok(events)
    }

    /// Scalars of a step.
    pub fn scalars(&mut self, step: u64, values: &[(&str, f64)]) -> Result<(), FileError> {
        let mut summary = Vec::new();
        for (tag, value) in values {
            let value = (*value as f32).to_le_bytes();
            summary.extend(bytes(1, &[&bytes(1, tag.as_bytes()), &field(2, 5), &value[..]].concat()));
        }
        self.record(seconds(), &[field(2, 0), varint(step), bytes(5, &summary)].concat())
    }

    /// An event at a time, with the fields behind it.
    fn record(&mut self, time: f64, fields: &[u8]) -> Result<(), FileError> {
        let data = [&field(1, 1), &time.to_le_bytes()[..], fields].concat();
        let length = (data.len() as u64).to_le_bytes();
        let record = [&length[..], &masked(&length).to_le_bytes(), &data, &masked(&data).to_le_bytes()].concat();
        self.file.write_all(&record).map_err(|source| FileError::write(&self.path, source))
    }
}

fn seconds() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

fn masked(data: &[u8]) -> u32 {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// A field's key: wire type 0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes.
fn field(number: u64, wire: u64) -> Vec<u8> {
    varint(number << 3 | wire)
}

fn bytes(number: u64, data: &[u8]) -> Vec<u8> {
    [&field(number, 2), &varint(data.len() as u64), data].concat()
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}
