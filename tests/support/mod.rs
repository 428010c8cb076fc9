//! What several tests share.
#![allow(dead_code)]
pub mod advice;
pub mod apart;
pub mod consistent;
pub mod data_set;
pub mod differences;
pub mod final_sum;
pub mod jax_sph;
pub mod lanes;
pub mod noise;
pub mod program;
pub mod random_scene;
pub mod standard;
pub mod summary;
