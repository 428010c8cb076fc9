//! Memory for many equal blocks that come and go: the kept states of a gradient.
//!
//! A run of 2000 steps of 950 particles keeps 130 MB of states, and on a virtual machine most of the time of keeping them
//! went into the kernel's clearing of fresh pages of 4 kB. Here they lie in maps of whole huge pages (2 MiB), which are
//! cleared 512 times less often, and a block that is given back is the next one handed out.

use memmap2::MmapMut;
use std::sync::{Arc, Mutex, MutexGuard};

/// Size of a huge page.
const HUGE: usize = 2 << 20;
/// The largest map.
const LARGEST: usize = 32 * HUGE;

/// Blocks of one size.
#[derive(Debug, Clone, Default)]
pub struct Blocks(Arc<Mutex<Maps>>);

#[derive(Debug, Default)]
struct Maps {
    /// Bytes of a block.
    size: usize,
    maps: Vec<MmapMut>,
    /// Map and offset of blocks that nobody has.
    free: Vec<(usize, usize)>,
    /// Bytes of the blocks that are out, now and at most.
    now: usize,
    most: usize,
}

/// A block; given back when dropped.
#[derive(Debug)]
pub struct Block {
    blocks: Blocks,
    map: usize,
    offset: usize,
    bytes: usize,
    /// Of the blocks when this one was made.
    size: usize,
}

impl Blocks {
    /// A block of `count` numbers that `fill` writes.
    ///
    /// Errors: no memory.
    pub fn keep<T: bytemuck::Pod>(&self, count: usize, fill: impl FnOnce(&mut [T])) -> std::io::Result<Block> {
        let bytes = count * std::mem::size_of::<T>();
        let mut maps = self.lock();
        if maps.size < bytes {
            // The first block, or a larger one: the smaller ones that are out keep their maps.
            maps.size = bytes.next_multiple_of(64);
            maps.free.clear();
        }
        if maps.free.is_empty() {
            maps.grow()?;
        }
        let Some((map, offset)) = maps.free.pop() else {
            return Err(std::io::Error::other("a new map has no block"));
        };
        fill(bytemuck::cast_slice_mut(&mut maps.maps[map][offset..offset + bytes]));
        maps.now += maps.size;
        maps.most = maps.most.max(maps.now);
        Ok(Block { blocks: self.clone(), map, offset, bytes, size: maps.size })
    }

    /// Bytes of the blocks that were out at the same time, at most. What they take of the machine is up to a huge page more.
    pub fn most(&self) -> usize {
        self.lock().most
    }

    fn lock(&self) -> MutexGuard<'_, Maps> {
        self.0.lock().unwrap_or_else(|e| e.into_inner())
    }
}

impl Maps {
    /// One more map, about as large as all before together.
    fn grow(&mut self) -> std::io::Result<()> {
        let so_far: usize = self.maps.iter().map(|map| map.len()).sum();
        let length = so_far.min(LARGEST).max(self.size).next_multiple_of(HUGE);
        let map = MmapMut::map_anon(length)?;
        // Only advice: without huge pages it is slower, nothing else.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        let number = self.maps.len();
        self.free.extend((0..length / self.size).rev().map(|k| (number, k * self.size)));
        self.maps.push(map);
        Ok(())
    }
}

impl Block {
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Writes the numbers, of the type that they were kept in.
    pub fn write<T: bytemuck::Pod>(&mut self, fill: impl FnOnce(&mut [T])) {
        let mut maps = self.blocks.lock();
        fill(bytemuck::cast_slice_mut(&mut maps.maps[self.map][self.offset..self.offset + self.bytes]));
    }

    /// Reads the numbers, of the type that they were kept in.
    pub fn read<T: bytemuck::Pod, U>(&self, f: impl FnOnce(&[T]) -> U) -> U {
        let maps = self.blocks.lock();
        f(bytemuck::cast_slice(&maps.maps[self.map][self.offset..self.offset + self.bytes]))
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        let mut maps = self.blocks.lock();
        maps.now -= self.size;
        // Blocks of a former, smaller size are not handed out again.
        if self.size == maps.size {
            maps.free.push((self.map, self.offset));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keep<T: bytemuck::Pod>(blocks: &Blocks, values: &[T]) -> Block {
        blocks.keep(values.len(), |block| block.copy_from_slice(values)).unwrap()
    }

    #[test]
    fn blocks_keep_what_they_were_given_and_are_used_again() {
        let blocks = Blocks::default();
        let numbers = |k: usize| -> Vec<f64> { (0..5000).map(|i| (i * k) as f64).collect() };
        let mut kept: Vec<Option<Block>> = (0..300).map(|k| Some(keep(&blocks, &numbers(k)))).collect();
        let maps = blocks.lock().maps.len();
        assert!(maps > 1);
        for round in 0..5 {
            for k in (round..300).step_by(3) {
                for number in [k + 1, k] {
                    kept[k] = None;
                    kept[k] = Some(keep(&blocks, &numbers(number)));
                }
            }
        }
        for (k, block) in kept.iter().enumerate() {
            block.as_ref().unwrap().read(|values: &[f64]| assert_eq!(values, numbers(k)));
        }
        assert_eq!(blocks.lock().maps.len(), maps);
    }

    #[test]
    fn another_size_leaves_the_old_blocks_alone() {
        let blocks = Blocks::default();
        let small = keep(&blocks, &[1.0f32; 10]);
        let large = keep(&blocks, &[2.0f64; 1_000_000]);
        let shorter = keep(&blocks, &[3.0f64; 5]);
        small.read(|values: &[f32]| assert_eq!(values, [1.0; 10]));
        shorter.read(|values: &[f64]| assert_eq!(values, [3.0; 5]));
        drop((small, shorter));
        // The shorter one's place is used again, the small one's is too small.
        let maps = blocks.lock().maps.len();
        let again = keep(&blocks, &[4.0f64; 1_000_000]);
        assert_eq!(blocks.lock().maps.len(), maps);
        large.read(|values: &[f64]| assert!(values.len() == 1_000_000 && values.iter().all(|&x| x == 2.0)));
        again.read(|values: &[f64]| assert!(values.iter().all(|&x| x == 4.0)));
    }
}
