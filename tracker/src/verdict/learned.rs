//! Learned: `cargo bench -p isophote-benches --bench verdict -- --learn 140 0` writes this file.
//!
//! From 942 fits, 330 of which are right, in rendered scenes with documents of these digests:
//! - sha256:eafccab081887346a8629050cc0827f9580f4e24b2735086b8d984c8a12bc015 spot
//! - sha256:0dbcdcb457eb171a4b846739eaf9abd6edc6b2b0e2eb80dff118019c57931adc gaussian
//! - sha256:22940728fa7be126e7c741f7a6ddac023e751cf8b9e70447a520c41a0b80b38e moffat
//! - sha256:c1545a5e0ff72f18cfa22620dac739a2b74c7cda4872b1dce5d708ee1aa251bd ring
//! - sha256:d2bfb0e3e9b49fc33cc73246672d50fd9175beefd9f4cc4e6fac17f1faa1ac51 bright-disc
//! - sha256:7da10265af845bc3e3a60e0441e6344ee7ab245f9a0fd3af15e3d4ad67d2f3cd exp(-s^2)
//! - sha256:6ffce33cab8634b23fc53647b7e9350fa52fa6f54b59c419b865e57f458dd9e6 1/(1 + s^2)
//! - sha256:93dc149cf8dafc91052d8a115a7fbaa9b4af3e3011fcaad7697e193a3e76b4d8 if(s <= 1, (1 - s)^2, 0)

/// ln odds of the target against another thing, where all numbers are 0.
pub(super) const PRIOR: f64 = -0.640;
/// The weight of each of [`super::Signs::numbers`].
pub(super) const WEIGHTS: [f64; 5] = [0.341, -0.593, -0.658, -8.465, -7.704];
