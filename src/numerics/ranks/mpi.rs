//! Ranks by MPI (rsmpi's bindings).

use super::How;
use crate::error::BadInput;
use ::mpi::collective::SystemOperation;
use ::mpi::environment::Universe;
use ::mpi::ffi;
use ::mpi::topology::SimpleCommunicator;
use ::mpi::traits::{AsRaw, Communicator, CommunicatorCollectives, Equivalence};
use ::mpi::Threading;
use std::mem::MaybeUninit;

/// All processes that were started together.
pub struct World {
    communicator: SimpleCommunicator,
    here: usize,
    /// Dropped last: that ends MPI.
    _universe: Universe,
}

impl World {
    pub fn begin(several: usize) -> Result<Self, BadInput> {
        let failed = |problem: String| {
            BadInput::new(problem)
                .allowed("processes that were all started by the mpirun of the MPI that hydrograd was built with")
                .advice("mpirun -n 2 hydrograd ..., or Slurm's srun with a plugin for it")
        };
        // One thread at a time speaks to MPI: the first one, or the thread of a gradient, for which that one waits.
        let Some((universe, given)) = ::mpi::initialize_with_threading(Threading::Serialized) else {
            return Err(failed("MPI has begun already".into()));
        };
        if given < Threading::Serialized {
            return Err(failed("this MPI speaks to the thread that began only".into()));
        }
        let communicator = universe.world();
        if usize::try_from(communicator.size()) != Ok(several) {
            let found = communicator.size();
            return Err(failed(format!("{several} processes were started together, but MPI knows of {found}")));
        }
        let here = communicator.split_shared(communicator.rank()).size();
        Ok(Self { here: usize::try_from(here).unwrap_or(1), communicator, _universe: universe })
    }

    pub fn rank(&self) -> usize {
        usize::try_from(self.communicator.rank()).unwrap_or(0)
    }

    pub fn size(&self) -> usize {
        usize::try_from(self.communicator.size()).unwrap_or(1)
    }

    pub fn on_this_machine(&self) -> usize {
        self.here
    }

    pub fn all(&self, own: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; own.len() * self.size()];
        self.communicator.all_gather_into(own, &mut all[..]);
        all
    }

    /// One number for every rank: returns the number that each of them had for this one.
    pub fn counts(&self, own: &[f64]) -> Vec<f64> {
        let mut found = vec![0.0; own.len()];
        self.communicator.all_to_all_into(own, &mut found[..]);
        found
    }

    pub fn begin_swap(&self, to: Vec<(usize, Vec<f64>)>, from: &[(usize, usize)]) -> Swap {
        let found = from.iter().map(|&(_, count)| vec![0.0; count]).collect();
        let mut swap = Swap { to, found, requests: Vec::new() };
        let (kind, world) = (f64::equivalent_datatype().as_raw(), self.communicator.as_raw());
        let number = |count: usize| i32::try_from(count).expect("a message of fewer than 2^31 numbers");
        // SAFETY (all): the buffers live in the swap, are not touched and do not move until all requests are done, and are as long as
        // MPI is told; MPI sets each request, or ends the program.
        for (numbers, &(rank, count)) in swap.found.iter_mut().zip(from) {
            let (mut request, to) = (MaybeUninit::uninit(), numbers.as_mut_ptr().cast());
            unsafe { ffi::MPI_Irecv(to, number(count), kind, number(rank), 0, world, request.as_mut_ptr()) };
            swap.requests.push(unsafe { request.assume_init() });
        }
        for (rank, numbers) in &swap.to {
            let (mut request, from) = (MaybeUninit::uninit(), numbers.as_ptr().cast());
            unsafe { ffi::MPI_Isend(from, number(numbers.len()), kind, number(*rank), 0, world, request.as_mut_ptr()) };
            swap.requests.push(unsafe { request.assume_init() });
        }
        swap
    }

    pub fn begin_exchange(&self, numbers: Vec<f64>, how: How) -> Exchange {
        let count = i32::try_from(numbers.len()).expect("a network of fewer than 2^31 numbers");
        let mut found = vec![0.0_f64; numbers.len() * if how == How::Gather { self.size() } else { 1 }];
        let (from, to) = (numbers.as_ptr().cast(), found.as_mut_ptr().cast());
        let (kind, sum, world) =
            (f64::equivalent_datatype().as_raw(), SystemOperation::sum().as_raw(), self.communicator.as_raw());
        let mut request = MaybeUninit::uninit();
        // SAFETY: both buffers live in the exchange, which nobody reads or frees before MPI is done with them, and are as long
        // as MPI is told. MPI sets the request, or ends the program.
        let request = unsafe {
            match how {
                How::Sum => ffi::MPI_Iallreduce(from, to, count, kind, sum, world, request.as_mut_ptr()),
                How::Gather => ffi::MPI_Iallgather(from, count, kind, to, count, kind, world, request.as_mut_ptr()),
            };
            request.assume_init()
        };
        Exchange { own: numbers, found, request }
    }

    pub fn abort(&self, code: u8) {
        self.communicator.abort(i32::from(code));
    }
}

/// Messages on their way.
pub struct Swap {
    /// MPI reads them until the requests are done.
    to: Vec<(usize, Vec<f64>)>,
    found: Vec<Vec<f64>>,
    requests: Vec<ffi::MPI_Request>,
}

impl Swap {
    pub fn go_on(&mut self) {
        for request in &mut self.requests {
            let (mut done, mut status) = (0, MaybeUninit::uninit());
            // SAFETY: the request is of this swap, and a request that is done is none any more.
            unsafe { ffi::MPI_Test(request, &mut done, status.as_mut_ptr()) };
        }
    }

    /// Waits for what others have sent.
    pub fn wait(mut self) -> Vec<Vec<f64>> {
        self.finish();
        std::mem::take(&mut self.found)
    }

    fn finish(&mut self) {
        for request in &mut self.requests {
            let mut status = MaybeUninit::uninit();
            // SAFETY: as above.
            unsafe { ffi::MPI_Wait(request, status.as_mut_ptr()) };
        }
    }
}

impl Drop for Swap {
    /// Nobody frees numbers that are on their way.
    fn drop(&mut self) {
        self.finish();
    }
}

/// Numbers on their way.
pub struct Exchange {
    /// MPI reads it until the exchange is done.
    #[allow(dead_code)]
    own: Vec<f64>,
    found: Vec<f64>,
    request: ffi::MPI_Request,
}

// SAFETY: one thread at a time speaks to MPI (`Threading::Serialized`): the first one, or a gradient's, for which it waits.
unsafe impl Send for World {}
// SAFETY: as above.
unsafe impl Sync for World {}
// SAFETY: only the thread that speaks to MPI has it; candle's graph wants it to be able to move.
unsafe impl Send for Exchange {}

impl Exchange {
    /// MPI moves numbers only while somebody asks it something.
    pub fn go_on(&mut self) {
        let (mut done, mut status) = (0, MaybeUninit::uninit());
        // SAFETY: the request is of this exchange, and a request that is done is none any more.
        unsafe { ffi::MPI_Test(&mut self.request, &mut done, status.as_mut_ptr()) };
    }

    /// Waits for what became of them.
    pub fn wait(mut self) -> Vec<f64> {
        self.finish();
        std::mem::take(&mut self.found)
    }

    fn finish(&mut self) {
        let mut status = MaybeUninit::uninit();
        // SAFETY: as above.
        unsafe { ffi::MPI_Wait(&mut self.request, status.as_mut_ptr()) };
    }
}

impl Drop for Exchange {
    /// Nobody frees numbers that are on their way.
    fn drop(&mut self) {
        self.finish();
    }
}
