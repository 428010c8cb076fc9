//! The tests of the program and of the library, one module for each subject: one program, so that it is compiled and linked once.
//! Those that change a setting of their whole process are in `apart.rs`.

mod support;

// Tests begin in the order of their names, and this one takes longest: at the end it would leave a core idle.
#[path = "tutorial.rs"]
mod a_tutorial;

mod bad_input;
mod bench;
mod cloud;
mod command_line;
mod conduction;
mod config;
mod consistent;
mod custom_design;
mod custom_scene;
mod damaged_files;
mod dataset;
mod design;
mod design_command;
mod design_optimisers;
mod design_parametrisations;
mod design_problem;
mod division;
mod evaluate;
mod figure_errors;
mod fixed_particles;
mod flows;
mod formulations;
mod free_surface;
mod gns_parity;
mod gradient_check;
mod heated_channel_3d;
mod interrupted;
mod inverse;
mod io;
mod jax_sph_gradient_parity;
mod jax_sph_parity;
mod kernels;
mod lattice;
mod layers;
mod machine;
mod metrics;
mod neighbours;
mod numerics;
mod operators;
mod page;
mod periodic_box;
mod periods;
mod plan;
mod plots;
mod random_configurations;
mod ranks;
mod readme;
mod report;
mod rollout;
mod run_folder;
mod runs;
mod same_states;
mod scene;
mod schedule;
mod slurm;
mod space;
mod streamlines;
mod stress;
mod study;
mod summary;
mod surrogate;
mod surrogate_design;
mod surrogate_inverse;
mod thread_pool;
mod train;
mod training_settings;
mod validation;
mod verify;
mod warnings;
