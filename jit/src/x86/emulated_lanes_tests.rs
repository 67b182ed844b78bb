//! Software emulation of vectors, lane by lane.

use iced_x86::Register;

pub(super) type Vector = [u8; 64];

pub(super) fn lanes<const N: usize>(vector: &Vector) -> Vec<[u8; N]> {
    vector.chunks_exact(N).map(|lane| lane.try_into().unwrap()).collect()
}

pub(super) fn together<const N: usize>(lanes: impl IntoIterator<Item = [u8; N]>) -> Vector {
    let mut vector = [0; 64];
    vector.chunks_exact_mut(N).zip(lanes).for_each(|(place, lane)| place.copy_from_slice(&lane));
    vector
}

pub(super) fn singles(f: impl Fn(f32, f32, f32) -> f32, [a, b, c]: [&Vector; 3]) -> Vector {
    let [a, b, c] = [a, b, c].map(lanes::<4>);
    together((0..16).map(|i| {
        let [a, b, c] = [a[i], b[i], c[i]].map(f32::from_le_bytes);
        f(a, b, c).to_le_bytes()
    }))
}

pub(super) fn doubles(f: impl Fn(f64, f64, f64) -> f64, vectors: [&Vector; 3]) -> Vector {
    words(|a, b, c| f(f64::from_bits(a), f64::from_bits(b), f64::from_bits(c)).to_bits(), vectors)
}

pub(super) fn words(f: impl Fn(u64, u64, u64) -> u64, [a, b, c]: [&Vector; 3]) -> Vector {
    let [a, b, c] = [a, b, c].map(lanes::<8>);
    together((0..8).map(|i| {
        let [a, b, c] = [a[i], b[i], c[i]].map(u64::from_le_bytes);
        f(a, b, c).to_le_bytes()
    }))
}

/// Evaluates the predicate byte of a comparison instruction.
pub(super) fn compares(how: u8, a: f64, b: f64) -> bool {
    match how {
        0x00 => a == b,
        0x04 => a != b,
        0x11 => a < b,
        0x12 => a <= b,
        _ => panic!("comparison {how:#x}"),
    }
}

/// The number of a general register, and its bits.
pub(super) fn general(register: Register) -> (usize, u32) {
    let from = |first: Register, last: Register| {
        (first..=last).contains(&register).then(|| register as usize - first as usize)
    };
    // No program of the tests uses the second bytes of four registers, which are numbered in between.
    let byte = from(Register::AL, Register::BL).or_else(|| Some(4 + from(Register::SPL, Register::R15L)?));
    let found = [
        (from(Register::RAX, Register::R15), 64),
        (from(Register::EAX, Register::R15D), 32),
        (from(Register::AX, Register::R15W), 16),
        (byte, 8),
    ];
    let found = found.into_iter().find_map(|(number, bits)| Some((number?, bits)));
    found.unwrap_or_else(|| panic!("{register:?}"))
}
