//! Particle series for ParaView and PyVista: one `.vtp` per frame and a `.pvd` with the times.
//!
//! A `.vtp` is XML PolyData with the arrays as raw little-endian bytes after the text (`<AppendedData
//! encoding="raw">`), each preceded by its length in bytes as u64. Every particle is one vertex cell, so that it
//! shows without a filter. Surfaces are `.vtp` files of quadrilaterals.
//!
//! The crate `vtkio` (0.6) is not used: it writes arrays in base64, a third larger, and brings parsers (nom 3, quick-xml
//! 0.22) that coming compilers refuse.

use super::atomic::{prepare_output_folder, write_atomically, write_bytes_atomically};
use super::FileError;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Element type of velocity and scalars in the file; positions are always f64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    #[default]
    F64,
    /// Half the size; enough to look at.
    F32,
}

/// Particles at one time. Vectors are component-major `[D, N]`: all x first, then all y, then all z.
#[derive(Clone, Copy, Debug)]
pub struct ParticleFrame<'a> {
    /// D, 1 to 3; missing components are written as 0.
    pub dimension: usize,
    /// Time in scene units.
    pub time: f64,
    /// `[D, N]`, scene length units.
    pub position: &'a [f64],
    /// `[D, N]`, scene velocity units; empty leaves the array out.
    pub velocity: &'a [f64],
    /// Name and values `[N]`, for example temperature, density, pressure.
    pub scalars: &'a [(&'a str, &'a [f64])],
    /// `[N]`; empty leaves the array out.
    pub tag: &'a [u8],
    /// Which particles of all these are, `[N]`, where they are a part of them; empty leaves the array out.
    pub number: &'a [u32],
}

impl ParticleFrame<'_> {
    /// Number of particles N.
    fn count(&self) -> usize {
        self.position.len() / self.dimension.max(1)
    }

    /// Lengths must fit together, names must be usable.
    fn check(&self, path: &Path) -> Result<(), FileError> {
        let (count, vector) = (self.count(), self.dimension * self.count());
        let mut arrays = vec![("position", vector, self.position.len())];
        arrays.extend((!self.velocity.is_empty()).then_some(("velocity", vector, self.velocity.len())));
        arrays.extend((!self.tag.is_empty()).then_some(("tag", count, self.tag.len())));
        arrays.extend((!self.number.is_empty()).then_some(("number", count, self.number.len())));
        arrays.extend(self.scalars.iter().map(|(name, values)| (*name, count, values.len())));
        FileError::check_lengths(path, self.dimension, count, &arrays)?;
        for (index, (name, _)) in self.scalars.iter().enumerate() {
            let doubled = self.scalars[..index].iter().any(|(other, _)| other == name);
            if doubled || ["", "velocity", "tag", "number"].contains(name) {
                let allowed = "a name of its own, not empty, not `velocity`, `tag` or `number`";
                return Err(FileError::input(path, format!("a scalar is named `{name}`"), allowed));
            }
        }
        Ok(())
    }
}

/// One array of the appended block.
struct Block {
    /// XML attributes `type`, `Name`, `NumberOfComponents`.
    attributes: String,
    bytes: Vec<u8>,
}

impl Block {
    fn new(kind: &str, name: &str, components: usize, bytes: Vec<u8>) -> Self {
        let attributes = format!("type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\"", escaped(name));
        Self { attributes, bytes }
    }

    /// Reals in the wanted precision.
    fn reals(name: &str, components: usize, values: impl Iterator<Item = f64>, precision: Precision) -> Self {
        match precision {
            Precision::F64 => Self::new("Float64", name, components, values.flat_map(f64::to_le_bytes).collect()),
            Precision::F32 => {
                let bytes = values.flat_map(|value| (value as f32).to_le_bytes()).collect();
                Self::new("Float32", name, components, bytes)
            }
        }
    }

    fn integers(name: &str, values: impl Iterator<Item = usize>) -> Self {
        let bytes = values.flat_map(|value| (value as i64).to_le_bytes()).collect();
        Self::new("Int64", name, 1, bytes)
    }
}

/// Writes one frame as a `.vtp` file, atomically.
///
/// # Errors
/// [`FileError::Input`] if lengths or names do not fit, else system errors.
pub fn write_vtp(path: &Path, frame: &ParticleFrame, precision: Precision) -> Result<(), FileError> {
    frame.check(path)?;
    let count = frame.count();
    // VTK wants three components, particle after particle.
    let triples = |values: &'_ [f64]| -> Vec<f64> {
        (0..count)
            .flat_map(|particle| (0..3).map(move |axis| (particle, axis)))
            .map(|(particle, axis)| if axis < frame.dimension { values[axis * count + particle] } else { 0.0 })
            .collect()
    };

    let mut point_data = Vec::new();
    if !frame.velocity.is_empty() {
        point_data.push(Block::reals("velocity", 3, triples(frame.velocity).into_iter(), precision));
    }
    for (name, values) in frame.scalars {
        point_data.push(Block::reals(name, 1, values.iter().copied(), precision));
    }
    if !frame.tag.is_empty() {
        point_data.push(Block::new("UInt8", "tag", 1, frame.tag.to_vec()));
    }
    if !frame.number.is_empty() {
        point_data.push(Block::integers("number", frame.number.iter().map(|&number| number as usize)));
    }
    let points = Block::reals("Points", 3, triples(frame.position).into_iter(), Precision::F64);
    let vertices = [Block::integers("connectivity", 0..count), Block::integers("offsets", 1..count + 1)];
    write_poly_data(path, Some(frame.time), point_data, points, ("Verts", count, vertices))
}

/// Writes the file (`.pvtp`) of a frame that several processes have written pieces of, whose names without folder these are.
/// `like` has the arrays that all pieces have.
fn write_pieces(path: &Path, like: &ParticleFrame, pieces: &[String]) -> Result<(), FileError> {
    let array = |kind: &str, name: &str, components: usize| {
        format!("<PDataArray type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\"/>\n", escaped(name))
    };
    let mut text = String::from(
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"PPolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <PPolyData GhostLevel=\"0\">\n<PPointData>\n",
    );
    text.extend((!like.velocity.is_empty()).then(|| array("Float64", "velocity", 3)));
    text.extend(like.scalars.iter().map(|(name, _)| array("Float64", name, 1)));
    text.extend((!like.tag.is_empty()).then(|| array("UInt8", "tag", 1)));
    text.extend((!like.number.is_empty()).then(|| array("Int64", "number", 1)));
    let _ = write!(text, "</PPointData>\n<PPoints>\n{}</PPoints>\n", array("Float64", "Points", 3));
    for piece in pieces {
        let _ = writeln!(text, "<Piece Source=\"{}\"/>", escaped(piece));
    }
    text.push_str("</PPolyData>\n</VTKFile>\n");
    write_bytes_atomically(path, text.as_bytes())
}

/// Writes a surface of quadrilaterals as a `.vtp` file, atomically: `points` in scene length units, the numbers of each
/// quadrilateral's corners in order, and scalars at the points.
///
/// # Errors
/// [`FileError::Input`] if lengths do not fit or a corner is no point, else system errors.
pub fn write_surface(
    path: &Path,
    points: &[[f64; 3]],
    corners: &[[usize; 4]],
    scalars: &[(&str, &[f64])],
) -> Result<(), FileError> {
    if let Some((name, values)) = scalars.iter().find(|(_, values)| values.len() != points.len()) {
        let problem = format!("{name} has {} values", values.len());
        return Err(FileError::input(path, problem, format!("{}, one for each point", points.len())));
    }
    if let Some(corner) = corners.iter().flatten().find(|&&corner| corner >= points.len()) {
        let allowed = format!("less than {}", points.len());
        return Err(FileError::input(path, format!("a corner is point {corner}"), allowed));
    }
    let scalar = |(name, values): &(&str, &[f64])| Block::reals(name, 1, values.iter().copied(), Precision::F64);
    let all = points.iter().flatten().copied();
    let blocks = [
        Block::integers("connectivity", corners.iter().flatten().copied()),
        Block::integers("offsets", (1..=corners.len()).map(|k| 4 * k)),
    ];
    let point_data = scalars.iter().map(scalar).collect();
    let points = Block::reals("Points", 3, all, Precision::F64);
    write_poly_data(path, None, point_data, points, ("Polys", corners.len(), blocks))
}

/// `cells`, all of one kind: `Verts` or `Polys`, how many, connectivity and offsets.
fn write_poly_data(
    path: &Path,
    time: Option<f64>,
    point_data: Vec<Block>,
    points: Block,
    (kind, cells, blocks): (&str, usize, [Block; 2]),
) -> Result<(), FileError> {
    // Three numbers of eight bytes each.
    let count = points.bytes.len() / 24;
    let cells_of = |name: &str| if name == kind { cells } else { 0 };
    let piece = format!(
        "NumberOfPoints=\"{count}\" NumberOfVerts=\"{}\" NumberOfLines=\"0\" \
         NumberOfStrips=\"0\" NumberOfPolys=\"{}\">",
        cells_of("Verts"),
        cells_of("Polys")
    );
    let sections = [("PointData", point_data), ("Points", vec![points]), (kind, blocks.into())];
    write_sections(path, ("PolyData", ""), time, &piece, &sections)
}

/// A data set of a `kind` with attributes, of one piece with attributes.
fn write_sections(
    path: &Path,
    (kind, attributes): (&str, &str),
    time: Option<f64>,
    piece: &str,
    sections: &[(&str, Vec<Block>)],
) -> Result<(), FileError> {
    let mut offset = 0;
    let mut header = format!(
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"{kind}\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <{kind}{attributes}>\n",
    );
    if let Some(time) = time {
        // ParaView and PyVista read this name as the time of a single file.
        let _ = write!(
            header,
            "<FieldData>\n<DataArray type=\"Float64\" Name=\"TimeValue\" NumberOfTuples=\"1\" format=\"ascii\">\
             {time:?}</DataArray>\n</FieldData>\n"
        );
    }
    let _ = writeln!(header, "<Piece {piece}>");
    for (name, blocks) in sections {
        let _ = writeln!(header, "<{name}>");
        for block in blocks {
            let _ = writeln!(header, "<DataArray {} format=\"appended\" offset=\"{offset}\"/>", block.attributes);
            offset += size_of::<u64>() + block.bytes.len();
        }
        let _ = writeln!(header, "</{name}>");
    }
    let _ = write!(header, "</Piece>\n</{kind}>\n<AppendedData encoding=\"raw\">\n_");

    write_atomically(path, |writer| {
        writer.write_all(header.as_bytes())?;
        for block in sections.iter().flat_map(|(_, blocks)| blocks) {
            writer.write_all(&(block.bytes.len() as u64).to_le_bytes())?;
            writer.write_all(&block.bytes)?;
        }
        writer.write_all(b"\n</AppendedData>\n</VTKFile>\n")
    })
}

/// Fields at the points i L / N of a box, in C order: the last axis is the fastest.
pub struct Image<'a> {
    /// N along each axis.
    pub shape: &'a [usize],
    /// L along each axis.
    pub size: &'a [f64],
    pub time: f64,
    /// `[D][points]`.
    pub velocity: &'a [Vec<f64>],
    /// Name and values `[points]`.
    pub scalars: &'a [(&'a str, &'a [f64])],
}

/// Writes fields on a grid as a `.vti` file, atomically.
///
/// # Errors
/// System errors.
pub fn write_image(path: &Path, image: &Image) -> Result<(), FileError> {
    let d = image.shape.len();
    let along = |a: usize| if a < d { image.shape[a] } else { 1 };
    let [nx, ny, nz] = [along(0), along(1), along(2)];
    // VTK wants x as the fastest.
    let order = || (0..nx * ny * nz).map(|k| (k % nx * ny + k / nx % ny) * nz + k / (nx * ny));
    let velocity = order().flat_map(|i| (0..3).map(move |a| if a < d { image.velocity[a][i] } else { 0.0 }));
    let mut blocks = vec![Block::reals("velocity", 3, velocity, Precision::F64)];
    for (name, values) in image.scalars {
        blocks.push(Block::reals(name, 1, order().map(|i| values[i]), Precision::F64));
    }
    let spacing: Vec<String> =
        (0..3).map(|a| format!("{:?}", if a < d { image.size[a] / along(a) as f64 } else { 1.0 })).collect();
    let extent = format!("0 {} 0 {} 0 {}", nx - 1, ny - 1, nz - 1);
    let attributes = format!(" WholeExtent=\"{extent}\" Origin=\"0 0 0\" Spacing=\"{}\"", spacing.join(" "));
    let piece = format!("Extent=\"{extent}\"");
    write_sections(path, ("ImageData", &attributes), Some(image.time), &piece, &[("PointData", blocks)])
}

/// A series of frames in a folder: `<name>_000000.vtp`, `<name>_000001.vtp`, ..., and `<name>.pvd`. Where several processes write pieces,
/// `<name>_000000_0.vtp`, `<name>_000000_1.vtp`, ..., and `<name>_000000.pvtp`.
///
/// The `.pvd` is rewritten (atomically) after every frame: a run that is killed leaves a series that opens.
#[derive(Debug)]
pub struct VtkSeries {
    folder: PathBuf,
    name: String,
    /// Time and file name of each frame.
    frames: Vec<(f64, String)>,
}

impl VtkSeries {
    /// A new series; an older one of the same name is overwritten frame by frame.
    ///
    /// # Errors
    /// The folder cannot be created or written to; the name is not a plain file name.
    pub fn new(folder: &Path, name: &str) -> Result<Self, FileError> {
        if name.is_empty() || name.contains(['/', '\\', '\0']) {
            let allowed = "a plain file name without `/`";
            return Err(FileError::input(folder, format!("a series is named `{name}`"), allowed));
        }
        prepare_output_folder(folder)?;
        Ok(Self { folder: folder.to_owned(), name: name.to_owned(), frames: Vec::new() })
    }

    /// Writes the next frame and the list of frames so far; returns the path of the frame.
    pub fn write(&mut self, frame: &ParticleFrame) -> Result<PathBuf, FileError> {
        let file_name = format!("{}_{:06}.vtp", self.name, self.frames.len());
        let path = self.folder.join(&file_name);
        write_vtp(&path, frame, Precision::default())?;
        self.frames.push((frame.time, file_name));
        self.write_list()?;
        Ok(path)
    }

    /// Writes this process's piece of the next frame, number `piece` of so many, which is no frame before it is [`Self::join`]ed.
    pub fn write_piece(&self, frame: &ParticleFrame, piece: usize) -> Result<(), FileError> {
        write_vtp(&self.folder.join(self.piece(piece)), frame, Precision::default())
    }

    fn piece(&self, piece: usize) -> String {
        format!("{}_{:06}_{piece}.vtp", self.name, self.frames.len())
    }

    /// Goes on to the next frame, when all pieces of this one are there. One process writes the list of them (`.pvtp`) and of the frames
    /// so far; `like` is its piece.
    pub fn join(&mut self, like: &ParticleFrame, pieces: usize, writes: bool) -> Result<(), FileError> {
        let file_name = format!("{}_{:06}.pvtp", self.name, self.frames.len());
        let all: Vec<String> = (0..pieces).map(|piece| self.piece(piece)).collect();
        if writes {
            write_pieces(&self.folder.join(&file_name), like, &all)?;
        }
        self.frames.push((like.time, file_name));
        if writes {
            self.write_list()?;
        }
        Ok(())
    }

    /// Forgets the frames that are not before `time`: the next ones take their places.
    pub fn go_back(&mut self, time: f64) {
        self.frames.retain(|(of_frame, _)| *of_frame < time);
    }

    /// Path of the `.pvd` file.
    pub fn list_path(&self) -> PathBuf {
        self.folder.join(format!("{}.pvd", self.name))
    }

    fn write_list(&self) -> Result<(), FileError> {
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n\
             <VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
        );
        for (time, file) in &self.frames {
            let _ = writeln!(text, "<DataSet timestep=\"{time:?}\" group=\"\" part=\"0\" file=\"{}\"/>", escaped(file));
        }
        text.push_str("</Collection>\n</VTKFile>\n");
        write_bytes_atomically(&self.list_path(), text.as_bytes())
    }
}

/// Particles as a `.vtp` file of [`write_vtp`] has them: three components, zero where there are fewer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParticleFile {
    pub position: Vec<[f64; 3]>,
    /// Empty if the file has none.
    pub velocity: Vec<[f64; 3]>,
    /// By name.
    pub scalars: BTreeMap<String, Vec<f64>>,
    /// Empty if the file has none.
    pub tag: Vec<u8>,
    /// Empty if the file has none.
    pub number: Vec<u64>,
}

/// What stands between the text of a `.vtp` file and its numbers.
const APPENDED: &[u8] = b"<AppendedData encoding=\"raw\">\n_";

/// Reads a frame: a file of [`write_vtp`]'s, or of pieces, whose particles are in the order of their numbers then.
///
/// # Errors
/// System errors; a file that is none of ours, or cut short.
pub fn read_frame(path: &Path) -> Result<ParticleFile, FileError> {
    if path.extension().is_none_or(|extension| extension != "pvtp") {
        return read_vtp(path);
    }
    let text = std::fs::read_to_string(path).map_err(|source| FileError::read(path, source))?;
    let document = roxmltree::Document::parse(&text).map_err(|error| unreadable(path, &error.to_string()))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let sources = document.descendants().filter_map(|node| node.attribute("Source"));
    let pieces = sources.map(|name| read_vtp(&folder.join(name))).collect::<Result<Vec<_>, _>>()?;
    let mut order: Vec<(u64, usize, usize)> = Vec::new();
    for (k, piece) in pieces.iter().enumerate() {
        order.extend(piece.number.iter().enumerate().map(|(i, &number)| (number, k, i)));
    }
    order.sort_unstable();
    fn all<T: Copy>(order: &[(u64, usize, usize)], of: impl Fn(usize, usize) -> Option<T>) -> Vec<T> {
        order.iter().filter_map(|&(_, k, i)| of(k, i)).collect()
    }
    let names: Vec<&String> = pieces.first().map_or(vec![], |piece| piece.scalars.keys().collect());
    let scalar = |name: &String| all(&order, |k, i| pieces[k].scalars.get(name)?.get(i).copied());
    let file = ParticleFile {
        position: all(&order, |k, i| pieces[k].position.get(i).copied()),
        velocity: all(&order, |k, i| pieces[k].velocity.get(i).copied()),
        tag: all(&order, |k, i| pieces[k].tag.get(i).copied()),
        number: all(&order, |k, i| pieces[k].number.get(i).copied()),
        scalars: names.into_iter().map(|name| (name.clone(), scalar(name))).collect(),
    };
    match file.position.len() == pieces.iter().map(|piece| piece.position.len()).sum::<usize>() {
        true => file.checked(path),
        false => Err(unreadable(path, "its pieces do not number their particles")),
    }
}

impl ParticleFile {
    fn checked(self, path: &Path) -> Result<Self, FileError> {
        let count = self.position.len();
        let fits = |length: usize| length == count || length == 0;
        let all_fit = self.scalars.values().all(|values| values.len() == count);
        match all_fit && [self.velocity.len(), self.tag.len(), self.number.len()].into_iter().all(fits) {
            true => Ok(self),
            false => Err(unreadable(path, "its arrays have different lengths")),
        }
    }
}

/// Reads a file of [`write_vtp`]'s.
///
/// # Errors
/// System errors; a file that is none of ours, or cut short.
pub fn read_vtp(path: &Path) -> Result<ParticleFile, FileError> {
    let bytes = std::fs::read(path).map_err(|source| FileError::read(path, source))?;
    let damaged = |what: &str| unreadable(path, what);
    let end = bytes.windows(APPENDED.len()).position(|part| part == APPENDED);
    let end = end.ok_or_else(|| damaged("it has no appended numbers"))?;
    let (header, numbers) = (&bytes[..end], &bytes[end + APPENDED.len()..]);
    let header = format!("{}</VTKFile>", String::from_utf8_lossy(header));
    let document = roxmltree::Document::parse(&header).map_err(|error| damaged(&error.to_string()))?;
    let mut file = ParticleFile::default();
    for array in document.descendants().filter(|node| node.has_tag_name("DataArray")) {
        let attribute = |name: &str| array.attribute(name).unwrap_or_default();
        // Only what is in the block; the time stands in the text.
        let Ok(offset) = attribute("offset").parse::<usize>() else { continue };
        let rest = numbers.get(offset..).and_then(|rest| rest.split_first_chunk());
        let block = rest.and_then(|(length, rest)| rest.get(..usize::try_from(u64::from_le_bytes(*length)).ok()?));
        let block = block.ok_or_else(|| damaged(&format!("the array `{}` is cut short", attribute("Name"))))?;
        let reals = || -> Vec<f64> {
            match attribute("type") {
                "Float64" => block.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
                _ => block.as_chunks().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect(),
            }
        };
        let triples = || reals().as_chunks().0.to_vec();
        let is_real = ["Float64", "Float32"].contains(&attribute("type"));
        match attribute("Name") {
            "Points" => file.position = triples(),
            "velocity" => file.velocity = triples(),
            "tag" => file.tag = block.to_vec(),
            "number" => file.number = block.as_chunks().0.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect(),
            name if is_real => drop(file.scalars.insert(name.to_owned(), reals())),
            _ => {}
        }
    }
    file.checked(path)
}

/// The frames of a series, from its `.pvd`: time and file of each, in their order.
///
/// # Errors
/// System errors; a file that is no such list.
pub fn read_list(path: &Path) -> Result<Vec<(f64, PathBuf)>, FileError> {
    let text = std::fs::read_to_string(path).map_err(|source| FileError::read(path, source))?;
    let document = roxmltree::Document::parse(&text).map_err(|error| unreadable(path, &error.to_string()))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let frame =
        |node: roxmltree::Node| Some((node.attribute("timestep")?.parse().ok()?, folder.join(node.attribute("file")?)));
    Ok(document.descendants().filter(|node| node.has_tag_name("DataSet")).filter_map(frame).collect())
}

fn unreadable(path: &Path, what: &str) -> FileError {
    FileError::Damaged {
        path: path.to_owned(),
        format: "VTK file",
        what: what.to_owned(),
        hint: "give one that hydrograd wrote",
    }
}

/// Text inside an XML attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
