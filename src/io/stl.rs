//! Triangles of closed surfaces from STL files, binary or text.
//!
//! A surface has an inside only if it is closed: each edge belongs to exactly two triangles, which run along it in opposite
//! directions. Where all normals point inwards, all triangles are turned round.

use super::FileError;
use std::collections::HashMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A closed surface: triangles counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Triangles {
    pub vertices: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

const CLOSED: &str =
    "close and orient the surface, for example in MeshLab (Filters, Cleaning and Repairing: Merge Close Vertices, \
                      Close Holes, Re-Orient All Faces Coherently) or with Blender's 3D-Print Toolbox";
/// The least height of a triangle, in its longest edge.
const LEAST_HEIGHT: f64 = 1e-6;

fn shown(p: [f64; 3]) -> String {
    format!("({}, {}, {})", p[0] as f32, p[1] as f32, p[2] as f32)
}

pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|d| a[d] - b[d])
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

impl Triangles {
    pub fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|k| self.vertices[k as usize])
    }

    /// Normal times area of a triangle.
    pub fn area(&self, triangle: usize) -> [f64; 3] {
        let [a, b, c] = self.corners(triangle);
        cross(minus(b, a), minus(c, a)).map(|x| 0.5 * x)
    }

    /// The volume inside, and its centroid.
    pub fn volume(&self) -> (f64, [f64; 3]) {
        let (mut volume, mut moment) = (0.0, [0.0; 3]);
        for triangle in 0..self.triangles.len() {
            // The tetrahedron with its fourth corner at the origin.
            let [a, b, c] = self.corners(triangle);
            let own = dot(a, cross(b, c)) / 6.0;
            volume += own;
            (0..3).for_each(|d| moment[d] += own * 0.25 * (a[d] + b[d] + c[d]));
        }
        (volume, moment.map(|x| x / volume))
    }

    /// Checks that the surface is closed, and turns it round if its normals point inwards. `path` is for messages.
    ///
    /// # Errors
    /// Numbers that are not finite, triangles without an area, and edges that are not those of two triangles.
    pub fn closed(mut self, path: &Path) -> Result<Self, FileError> {
        let bad = |name: String, found: String, allowed: &str, hint: &'static str| {
            Err(FileError::Mismatch { path: path.to_owned(), name, found, allowed: allowed.into(), hint })
        };
        if self.triangles.len() < 4 {
            let found = format!("{} in number", self.triangles.len());
            return bad("triangles".into(), found, "at least 4, those of a closed surface", CLOSED);
        }
        for k in 0..self.triangles.len() {
            let corners = self.corners(k);
            if let Some(wrong) = corners.iter().flatten().find(|x| !x.is_finite()) {
                return bad(
                    format!("triangle {k}"),
                    format!("one with the coordinate {wrong}"),
                    "one of finite numbers",
                    CLOSED,
                );
            }
            let edge = |k: usize| minus(corners[(k + 1) % 3], corners[k]);
            let longest = (0..3).map(|k| dot(edge(k), edge(k))).fold(0.0, f64::max);
            let area = self.area(k);
            if dot(area, area).sqrt() * 2.0 <= LEAST_HEIGHT * longest {
                return bad(
                    format!("triangle {k}"),
                    format!("without an area, with corners {}", corners.map(shown).join(", ")),
                    "one with three corners that are not on a line",
                    "remove triangles without an area, for example in MeshLab (Filters, Cleaning and Repairing: Remove Zero Area Faces)",
                );
            }
        }
        let mut edges: HashMap<(u32, u32), Vec<usize>> = HashMap::new();
        for (k, triangle) in self.triangles.iter().enumerate() {
            (0..3).for_each(|e| edges.entry((triangle[e], triangle[(e + 1) % 3])).or_default().push(k));
        }
        for (k, triangle) in self.triangles.iter().enumerate() {
            for e in 0..3 {
                let (from, to) = (triangle[e], triangle[(e + 1) % 3]);
                let (along, against) = (edges[&(from, to)].len(), edges.get(&(to, from)).map_or(0, Vec::len));
                if (along, against) == (1, 1) {
                    continue;
                }
                let ends = [from, to].map(|v| shown(self.vertices[v as usize])).join(" - ");
                let found = match (along, against) {
                    (1, 0) => "that of one triangle: the surface has a hole there".to_string(),
                    (2, 0) => {
                        "run along in the same direction by two triangles: one of them is turned round".to_string()
                    }
                    _ => format!("that of {} triangles", along + against),
                };
                return bad(
                    format!("edge {ends} of triangle {k}"),
                    found,
                    "that of exactly two triangles, in opposite directions",
                    CLOSED,
                );
            }
        }
        if self.volume().0 < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        Ok(self)
    }
}

/// Reads a closed surface.
///
/// # Errors
/// A file that is none, and a surface that is not closed.
pub fn read(path: &Path) -> Result<Triangles, FileError> {
    let file = File::open(path).map_err(|source| FileError::read(path, source))?;
    let mesh = stl_io::read_stl(&mut BufReader::new(file)).map_err(|error| FileError::Damaged {
        path: path.to_owned(),
        format: "STL file",
        what: error.to_string(),
        hint: "give an STL file, binary or text",
    })?;
    let vertices = mesh.vertices.iter().map(|v| std::array::from_fn(|d| f64::from(v[d]))).collect();
    let triangles = mesh.faces.iter().map(|face| face.vertices.map(|k| k as u32)).collect();
    Triangles { vertices, triangles }.closed(path)
}
