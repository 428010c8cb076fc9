//! Named tensors and text in one safetensors file: checkpoints of any kind.
//!
//! The header is put together here instead of by the crate's `serialize`, which orders the metadata at random:
//! equal contents give equal bytes. Reading goes through the crate, which validates the file.

use super::atomic::write_atomically;
use super::FileError;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The metadata entry with the CRC-32C of the whole file, in which this entry is [`OPEN`]. Files of other programs have
/// none.
const CHECKSUM: &str = "checksum";
const OPEN: &str = "00000000";
/// The entry of versions up to 0.1.0, with the CRC-32C of the tensors' bytes alone: in such a file no more is checked.
const OF_TENSORS: &str = "crc32c";
const HINT_TENSOR: &str = "the file may come from another version or another kind of run";

/// Elements of a tensor in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    F64(Vec<f64>),
    F32(Vec<f32>),
    U64(Vec<u64>),
    I64(Vec<i64>),
    I32(Vec<i32>),
}

// The bytes of numbers in memory are those in the file, which are little-endian.
const _: () = assert!(cfg!(target_endian = "little"));

impl Data {
    /// Number of elements.
    pub fn count(&self) -> usize {
        self.bytes().len() / self.kind().1
    }

    /// Name of the element type in the format, and its bytes per element.
    fn kind(&self) -> (&'static str, usize) {
        match self {
            Self::F64(_) => ("F64", 8),
            Self::F32(_) => ("F32", 4),
            Self::U64(_) => ("U64", 8),
            Self::I64(_) => ("I64", 8),
            Self::I32(_) => ("I32", 4),
        }
    }

    fn bytes(&self) -> &[u8] {
        match self {
            Self::F64(values) => bytemuck::cast_slice(values),
            Self::F32(values) => bytemuck::cast_slice(values),
            Self::U64(values) => bytemuck::cast_slice(values),
            Self::I64(values) => bytemuck::cast_slice(values),
            Self::I32(values) => bytemuck::cast_slice(values),
        }
    }
}

/// Tensors by name: shape and elements.
pub type Tensors = BTreeMap<String, (Vec<usize>, Data)>;

/// Writes tensors and metadata atomically; equal contents give equal bytes.
///
/// # Errors
/// [`FileError::Input`] if a shape does not hold the number of elements or a name is reserved; system errors.
pub fn write_tensors(path: &Path, tensors: &Tensors, metadata: &BTreeMap<String, String>) -> Result<(), FileError> {
    for (name, (shape, data)) in tensors {
        let elements: usize = shape.iter().product();
        if elements != data.count() {
            return Err(FileError::input(
                path,
                format!("tensor `{name}` has shape {shape:?} but {} elements", data.count()),
                format!("{elements} elements for this shape"),
            ));
        }
        if name == "__metadata__" {
            return Err(FileError::input(
                path,
                "a tensor is named `__metadata__`",
                "any other name (the format keeps this one for itself)",
            ));
        }
    }
    // Wide elements first keeps every tensor aligned (the crate requires no gaps).
    let mut ordered: Vec<_> = tensors.iter().collect();
    ordered.sort_by_key(|(_, (_, data))| std::cmp::Reverse(data.kind().1));

    let mut metadata = metadata.clone();
    metadata.insert(CHECKSUM.to_owned(), OPEN.to_owned());
    let mut header = serde_json::Map::new();
    header.insert("__metadata__".to_owned(), serde_json::json!(metadata));
    let mut offset = 0;
    for (name, (shape, data)) in &ordered {
        let end = offset + data.bytes().len();
        let entry = serde_json::json!({"dtype": data.kind().0, "shape": shape, "data_offsets": [offset, end]});
        header.insert((*name).clone(), entry);
        offset = end;
    }
    let text = serde_json::Value::Object(header).to_string().into_bytes();
    let size = text.len().next_multiple_of(8);
    let mut header = (size as u64).to_le_bytes().to_vec();
    header.extend(text);
    header.resize(size + 8, b' ');
    let of_header = crc32c::crc32c(&header);
    let checksum = ordered.iter().fold(of_header, |sum, (_, (_, data))| crc32c::crc32c_append(sum, data.bytes()));
    if let Some(at) = place(&header, OPEN) {
        header[at].copy_from_slice(format!("{checksum:08x}").as_bytes());
    }

    write_atomically(path, |writer| {
        writer.write_all(&header)?;
        ordered.iter().try_for_each(|(_, (_, data))| writer.write_all(data.bytes()))
    })
}

/// Where a header has this checksum. (Within other texts of the header quotation marks are preceded by a backslash.)
fn place(header: &[u8], checksum: &str) -> Option<Range<usize>> {
    let mark = format!("\"{CHECKSUM}\":\"{checksum}\"");
    let at = header.windows(mark.len()).position(|part| part == mark.as_bytes())? + mark.len() - 1;
    Some(at - checksum.len()..at)
}

/// Whether a file, whose first part is its header, has the checksum that is in its metadata.
fn is_whole(bytes: &[u8], header: usize, metadata: &mut HashMap<String, String>) -> bool {
    let of_tensors = metadata.remove(OF_TENSORS);
    match metadata.remove(CHECKSUM) {
        Some(expected) => place(&bytes[..header], &expected).is_some_and(|at| {
            let before = crc32c::crc32c_append(crc32c::crc32c(&bytes[..at.start]), OPEN.as_bytes());
            expected == format!("{:08x}", crc32c::crc32c_append(before, &bytes[at.end..]))
        }),
        None => of_tensors.is_none_or(|expected| expected == format!("{:08x}", crc32c::crc32c(&bytes[header..]))),
    }
}

/// Contents of a tensor file, with access by name that explains what is wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorFile {
    pub path: PathBuf,
    pub tensors: Tensors,
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Reads a whole file.
    ///
    /// # Errors
    /// The file is missing, cut short, damaged, or has tensors of types other than F64, F32, U64, I64, I32.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let bytes = std::fs::read(path).map_err(|source| FileError::read(path, source))?;
        Self::parse(path, &bytes)
    }

    /// The contents of a file, which messages call `path`.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, FileError> {
        let damaged = |what: String| FileError::Damaged {
            path: path.to_owned(),
            format: "safetensors file",
            what,
            hint: "take an earlier checkpoint or start without one",
        };
        let invalid = |error: SafeTensorError| damaged(format!("{error} ({} bytes)", bytes.len()));
        let (size, header) = SafeTensors::read_metadata(bytes).map_err(invalid)?;
        let mut metadata = header.metadata().clone().unwrap_or_default();
        // The header begins with its own length, eight bytes.
        if !is_whole(bytes, size + 8, &mut metadata) {
            return Err(damaged("its numbers or texts are not those that were written (checksum)".to_owned()));
        }
        let file = SafeTensors::deserialize(bytes).map_err(invalid)?;
        let mut tensors = Tensors::new();
        for (name, view) in file.iter() {
            let data = match view.dtype() {
                Dtype::F64 => Data::F64(words(view.data(), f64::from_le_bytes)),
                Dtype::F32 => Data::F32(words(view.data(), f32::from_le_bytes)),
                Dtype::U64 => Data::U64(words(view.data(), u64::from_le_bytes)),
                Dtype::I64 => Data::I64(words(view.data(), i64::from_le_bytes)),
                Dtype::I32 => Data::I32(words(view.data(), i32::from_le_bytes)),
                other => {
                    return Err(FileError::Mismatch {
                        path: path.to_owned(),
                        name: name.to_owned(),
                        found: format!("a tensor of {other:?}"),
                        allowed: "of F64, F32, U64, I64 or I32".to_owned(),
                        hint: "convert it first",
                    })
                }
            };
            tensors.insert(name.to_owned(), (view.shape().to_vec(), data));
        }
        Ok(Self { path: path.to_owned(), tensors, metadata: metadata.into_iter().collect() })
    }

    /// Elements of the f64 tensor `name`, which must have the given shape.
    pub fn f64(&self, name: &str, shape: &[usize]) -> Result<&[f64], FileError> {
        let mismatch = |found: String, allowed: String| FileError::Mismatch {
            path: self.path.clone(),
            name: name.to_owned(),
            found,
            allowed,
            hint: HINT_TENSOR,
        };
        match (self.shape(name)?, &self.tensors[name].1) {
            (found, _) if found != shape => Err(mismatch(format!("of shape {found:?}"), format!("of shape {shape:?}"))),
            (_, Data::F64(values)) => Ok(values),
            (_, other) => Err(mismatch(format!("a tensor of {}", other.kind().0), "of F64".to_owned())),
        }
    }

    /// Elements of a tensor of any type as f64, row-major, with its shape.
    pub fn numbers(&self, name: &str) -> Result<(&[usize], Vec<f64>), FileError> {
        let shape = self.shape(name)?;
        let numbers = match &self.tensors[name].1 {
            Data::F64(values) => values.clone(),
            Data::F32(values) => values.iter().map(|&v| f64::from(v)).collect(),
            Data::U64(values) => values.iter().map(|&v| v as f64).collect(),
            Data::I64(values) => values.iter().map(|&v| v as f64).collect(),
            Data::I32(values) => values.iter().map(|&v| f64::from(v)).collect(),
        };
        Ok((shape, numbers))
    }

    /// The metadata text `key`.
    pub fn text(&self, key: &str) -> Result<&str, FileError> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or_else(|| self.missing("metadata entry", key, self.metadata.keys()))
    }

    /// Shape of the tensor `name`, for those whose size is not known beforehand.
    pub fn shape(&self, name: &str) -> Result<&[usize], FileError> {
        self.tensors
            .get(name)
            .map(|(shape, _)| shape.as_slice())
            .ok_or_else(|| self.missing("tensor", name, self.tensors.keys()))
    }

    fn missing<'a>(&self, kind: &'static str, name: &str, present: impl Iterator<Item = &'a String>) -> FileError {
        FileError::Missing {
            path: self.path.clone(),
            kind,
            name: name.to_owned(),
            present: present.cloned().collect(),
            hint: HINT_TENSOR,
        }
    }
}

/// Little-endian bytes to numbers; the crate has already checked that the length is a multiple of `BYTES`.
fn words<const BYTES: usize, T>(bytes: &[u8], convert: fn([u8; BYTES]) -> T) -> Vec<T> {
    let (chunks, _) = bytes.as_chunks::<BYTES>();
    chunks.iter().map(|chunk| convert(*chunk)).collect()
}
