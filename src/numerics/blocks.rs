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
