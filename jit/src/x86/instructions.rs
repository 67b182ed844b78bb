//! The vector instructions of x86-64: one table for 256 bits (AVX2, FMA) and 512 bits (AVX-512).

use iced_x86::{Code, Register};

use crate::options::VectorWidth;
use crate::vector::{Element, Operation, Portion};

/// Operand order of fused multiply-add.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum FmaForm {
    /// to = to · third + second
    F132,
    /// to = second · to + third
    F213,
    /// to = second · third + to
    F231,
}

/// Whether the last operand may be in memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum InMemory {
    Never,
    /// A full operand, or at 512 bits an element broadcast to all lanes.
    Any,
    /// Memory only.
    Always,
}

impl Operation {
    pub(super) fn in_memory(self) -> InMemory {
        use Operation::*;
        match self {
            UpperHalf | ShiftLeft(_) | ShiftRight(_) | SpreadFirst | Join => InMemory::Never,
            FromBytes | FromWords | Load | LoadHalf | Spread => InMemory::Always,
            _ => InMemory::Any,
        }
    }

    pub(super) fn is_commutative(self) -> bool {
        use Operation::*;
        matches!(self, Add | Mul | And | Or | Xor | AddBits | EqualBits)
    }

    /// The element of the operands: of 32 bits where an operation makes 64.
    pub(super) fn source(self, element: Element) -> Element {
        match self {
            Operation::FromIntegers | Operation::Widen => Element::Single,
            _ => element,
        }
    }

    /// Portions of the result and of the last operand.
    pub(super) fn extents(self, element: Element) -> [Portion; 2] {
        use Portion::*;
        match (self, element) {
            (Operation::Widen, _) | (Operation::FromIntegers, Element::Double) => [Whole, Half],
            (Operation::Narrow | Operation::UpperHalf, _) => [Half, Whole],
            (Operation::FromBytes | Operation::FromWords, Element::Double) | (Operation::LoadHalf, _) => [Half, Half],
            (Operation::Join, _) => [Whole, Half],
            (Operation::SpreadFirst, _) => [Whole, Least],
            _ => [Whole, Whole],
        }
    }

    /// The immediate byte, if there is one.
    pub fn immediate(self, width: VectorWidth) -> Option<u32> {
        match self {
            Operation::Compare(by) | Operation::ShiftLeft(by) | Operation::ShiftRight(by) | Operation::Pieces(by) => {
                Some(by.into())
            }
            Operation::UpperHalf | Operation::Join => Some(1),
            Operation::Select if width == VectorWidth::Bits512 => Some(SELECT),
            _ => None,
        }
    }

    /// The instruction: for f32 and f64 at 256 bits, for f32 and f64 at 512. At 512 bits a comparison leaves its result in a
    /// mask register, and `Select` picks by the bits of its first operand.
    pub fn code(self, element: Element, width: VectorWidth) -> Code {
        use Code::*;
        use Operation::*;
        let codes = match self {
            Add => [
                VEX_Vaddps_ymm_ymm_ymmm256,
                VEX_Vaddpd_ymm_ymm_ymmm256,
                EVEX_Vaddps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vaddpd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            Sub => [
                VEX_Vsubps_ymm_ymm_ymmm256,
                VEX_Vsubpd_ymm_ymm_ymmm256,
                EVEX_Vsubps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vsubpd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            Mul => [
                VEX_Vmulps_ymm_ymm_ymmm256,
                VEX_Vmulpd_ymm_ymm_ymmm256,
                EVEX_Vmulps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vmulpd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            Div => [
                VEX_Vdivps_ymm_ymm_ymmm256,
                VEX_Vdivpd_ymm_ymm_ymmm256,
                EVEX_Vdivps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vdivpd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            And => [
                VEX_Vandps_ymm_ymm_ymmm256,
                VEX_Vandpd_ymm_ymm_ymmm256,
                EVEX_Vandps_zmm_k1z_zmm_zmmm512b32,
                EVEX_Vandpd_zmm_k1z_zmm_zmmm512b64,
            ],
            AndNot => [
                VEX_Vandnps_ymm_ymm_ymmm256,
                VEX_Vandnpd_ymm_ymm_ymmm256,
                EVEX_Vandnps_zmm_k1z_zmm_zmmm512b32,
                EVEX_Vandnpd_zmm_k1z_zmm_zmmm512b64,
            ],
            Or => [
                VEX_Vorps_ymm_ymm_ymmm256,
                VEX_Vorpd_ymm_ymm_ymmm256,
                EVEX_Vorps_zmm_k1z_zmm_zmmm512b32,
                EVEX_Vorpd_zmm_k1z_zmm_zmmm512b64,
            ],
            Xor => [
                VEX_Vxorps_ymm_ymm_ymmm256,
                VEX_Vxorpd_ymm_ymm_ymmm256,
                EVEX_Vxorps_zmm_k1z_zmm_zmmm512b32,
                EVEX_Vxorpd_zmm_k1z_zmm_zmmm512b64,
            ],
            AddBits => [
                VEX_Vpaddd_ymm_ymm_ymmm256,
                VEX_Vpaddq_ymm_ymm_ymmm256,
                EVEX_Vpaddd_zmm_k1z_zmm_zmmm512b32,
                EVEX_Vpaddq_zmm_k1z_zmm_zmmm512b64,
            ],
            SubBits => alike(VEX_Vpsubq_ymm_ymm_ymmm256, EVEX_Vpsubq_zmm_k1z_zmm_zmmm512b64),
            EqualBits => alike(VEX_Vpcmpeqq_ymm_ymm_ymmm256, EVEX_Vpcmpeqq_kr_k1_zmm_zmmm512b64),
            Least => alike(VEX_Vpminud_ymm_ymm_ymmm256, EVEX_Vpminuq_zmm_k1z_zmm_zmmm512b64),
            Compare(_) => [
                VEX_Vcmpps_ymm_ymm_ymmm256_imm8,
                VEX_Vcmppd_ymm_ymm_ymmm256_imm8,
                EVEX_Vcmpps_kr_k1_zmm_zmmm512b32_imm8_sae,
                EVEX_Vcmppd_kr_k1_zmm_zmmm512b64_imm8_sae,
            ],
            Sqrt => [
                VEX_Vsqrtps_ymm_ymmm256,
                VEX_Vsqrtpd_ymm_ymmm256,
                EVEX_Vsqrtps_zmm_k1z_zmmm512b32_er,
                EVEX_Vsqrtpd_zmm_k1z_zmmm512b64_er,
            ],
            Fma => return FmaForm::F231.code(element, width),
            Select => [
                VEX_Vblendvps_ymm_ymm_ymmm256_ymm,
                VEX_Vblendvpd_ymm_ymm_ymmm256_ymm,
                EVEX_Vpternlogd_zmm_k1z_zmm_zmmm512b32_imm8,
                EVEX_Vpternlogq_zmm_k1z_zmm_zmmm512b64_imm8,
            ],
            ShiftLeft(_) => alike(VEX_Vpsllq_ymm_ymm_imm8, EVEX_Vpsllq_zmm_k1z_zmmm512b64_imm8),
            ShiftRight(_) => [
                VEX_Vpsrld_ymm_ymm_imm8,
                VEX_Vpsrlq_ymm_ymm_imm8,
                EVEX_Vpsrld_zmm_k1z_zmmm512b32_imm8,
                EVEX_Vpsrlq_zmm_k1z_zmmm512b64_imm8,
            ],
            Widen => alike(VEX_Vcvtps2pd_ymm_xmmm128, EVEX_Vcvtps2pd_zmm_k1z_ymmm256b32_sae),
            Narrow => alike(VEX_Vcvtpd2ps_xmm_ymmm256, EVEX_Vcvtpd2ps_ymm_k1z_zmmm512b64_er),
            UpperHalf => alike(VEX_Vextractf128_xmmm128_ymm_imm8, EVEX_Vextractf64x4_ymmm256_k1z_zmm_imm8),
            Join => alike(VEX_Vinsertf128_ymm_ymm_xmmm128_imm8, EVEX_Vinsertf64x4_zmm_k1z_zmm_ymmm256_imm8),
            Min => [
                VEX_Vminps_ymm_ymm_ymmm256,
                VEX_Vminpd_ymm_ymm_ymmm256,
                EVEX_Vminps_zmm_k1z_zmm_zmmm512b32_sae,
                EVEX_Vminpd_zmm_k1z_zmm_zmmm512b64_sae,
            ],
            Max => [
                VEX_Vmaxps_ymm_ymm_ymmm256,
                VEX_Vmaxpd_ymm_ymm_ymmm256,
                EVEX_Vmaxps_zmm_k1z_zmm_zmmm512b32_sae,
                EVEX_Vmaxpd_zmm_k1z_zmm_zmmm512b64_sae,
            ],
            Lows => alike(VEX_Vunpcklps_ymm_ymm_ymmm256, EVEX_Vunpcklps_zmm_k1z_zmm_zmmm512b32),
            Highs => alike(VEX_Vunpckhps_ymm_ymm_ymmm256, EVEX_Vunpckhps_zmm_k1z_zmm_zmmm512b32),
            Firsts => alike(VEX_Vunpcklpd_ymm_ymm_ymmm256, EVEX_Vunpcklpd_zmm_k1z_zmm_zmmm512b64),
            Seconds => alike(VEX_Vunpckhpd_ymm_ymm_ymmm256, EVEX_Vunpckhpd_zmm_k1z_zmm_zmmm512b64),
            Pieces(_) => alike(VEX_Vperm2f128_ymm_ymm_ymmm256_imm8, EVEX_Vshuff64x2_zmm_k1z_zmm_zmmm512b64_imm8),
            FromIntegers => [
                VEX_Vcvtdq2ps_ymm_ymmm256,
                VEX_Vcvtdq2pd_ymm_xmmm128,
                EVEX_Vcvtdq2ps_zmm_k1z_zmmm512b32_er,
                EVEX_Vcvtdq2pd_zmm_k1z_ymmm256b32_er,
            ],
            FromBytes => [
                VEX_Vpmovzxbd_ymm_xmmm64,
                VEX_Vpmovzxbd_xmm_xmmm32,
                EVEX_Vpmovzxbd_zmm_k1z_xmmm128,
                EVEX_Vpmovzxbd_ymm_k1z_xmmm64,
            ],
            FromWords => [
                VEX_Vpmovzxwd_ymm_xmmm128,
                VEX_Vpmovzxwd_xmm_xmmm64,
                EVEX_Vpmovzxwd_zmm_k1z_ymmm256,
                EVEX_Vpmovzxwd_ymm_k1z_xmmm128,
            ],
            // A masked load needs a mask bit per element.
            Load => [
                VEX_Vmovups_ymm_ymmm256,
                VEX_Vmovups_ymm_ymmm256,
                EVEX_Vmovups_zmm_k1z_zmmm512,
                EVEX_Vmovupd_zmm_k1z_zmmm512,
            ],
            LoadHalf => alike(VEX_Vmovups_xmm_xmmm128, EVEX_Vmovups_ymm_k1z_ymmm256),
            Spread => [
                VEX_Vbroadcastss_ymm_m32,
                VEX_Vbroadcastsd_ymm_m64,
                EVEX_Vbroadcastss_zmm_k1z_xmmm32,
                EVEX_Vbroadcastsd_zmm_k1z_xmmm64,
            ],
            SpreadFirst => [
                VEX_Vbroadcastss_ymm_xmm,
                VEX_Vbroadcastsd_ymm_xmm,
                EVEX_Vbroadcastss_zmm_k1z_xmmm32,
                EVEX_Vbroadcastsd_zmm_k1z_xmmm64,
            ],
        };
        pick(codes, element, width)
    }
}

/// The truth table of `a ? b : c`, for the ternary logic instruction.
const SELECT: u32 = 0xca;

/// Codes that both elements share, at 256 and at 512 bits.
fn alike(narrow: Code, wide: Code) -> [Code; 4] {
    [narrow, narrow, wide, wide]
}

fn pick(codes: [Code; 4], element: Element, width: VectorWidth) -> Code {
    codes[2 * usize::from(width == VectorWidth::Bits512) + element as usize]
}

impl FmaForm {
    pub fn code(self, element: Element, width: VectorWidth) -> Code {
        use Code::*;
        let codes = match self {
            FmaForm::F132 => [
                VEX_Vfmadd132ps_ymm_ymm_ymmm256,
                VEX_Vfmadd132pd_ymm_ymm_ymmm256,
                EVEX_Vfmadd132ps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vfmadd132pd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            FmaForm::F213 => [
                VEX_Vfmadd213ps_ymm_ymm_ymmm256,
                VEX_Vfmadd213pd_ymm_ymm_ymmm256,
                EVEX_Vfmadd213ps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vfmadd213pd_zmm_k1z_zmm_zmmm512b64_er,
            ],
            FmaForm::F231 => [
                VEX_Vfmadd231ps_ymm_ymm_ymmm256,
                VEX_Vfmadd231pd_ymm_ymm_ymmm256,
                EVEX_Vfmadd231ps_zmm_k1z_zmm_zmmm512b32_er,
                EVEX_Vfmadd231pd_zmm_k1z_zmm_zmmm512b64_er,
            ],
        };
        pick(codes, element, width)
    }
}

/// The instruction that stores a portion of a register.
pub(super) fn store(extent: Portion, element: Element, width: VectorWidth) -> Code {
    use Code::*;
    let codes = match extent {
        Portion::Whole => [
            VEX_Vmovups_ymmm256_ymm,
            VEX_Vmovups_ymmm256_ymm,
            EVEX_Vmovups_zmmm512_k1z_zmm,
            EVEX_Vmovups_zmmm512_k1z_zmm,
        ],
        Portion::Half => [
            VEX_Vmovups_xmmm128_xmm,
            VEX_Vmovups_xmmm128_xmm,
            EVEX_Vmovups_ymmm256_k1z_ymm,
            EVEX_Vmovups_ymmm256_k1z_ymm,
        ],
        // One element.
        Portion::Least => [VEX_Vmovss_m32_xmm, VEX_Vmovsd_m64_xmm, EVEX_Vmovss_m32_k1_xmm, EVEX_Vmovsd_m64_k1_xmm],
    };
    pick(codes, element, width)
}

/// The instruction that collects the truth of each lane: in a general register, or at 512 bits in a mask register.
pub(super) fn truths(element: Element, width: VectorWidth) -> Code {
    use Code::*;
    let codes = [VEX_Vmovmskps_r32_ymm, VEX_Vmovmskpd_r32_ymm, EVEX_Vpmovd2m_kr_zmm, EVEX_Vpmovq2m_kr_zmm];
    pick(codes, element, width)
}

/// The instruction that gathers 64 bits for each lane, at 64-bit indices.
pub(super) fn gather(width: VectorWidth) -> Code {
    match width {
        VectorWidth::Bits512 => Code::EVEX_Vgatherqpd_zmm_k1_vm64z,
        _ => Code::VEX_Vgatherqpd_ymm_vm64y_ymm,
    }
}

/// The instruction that expands a mask register to truth values.
pub(super) fn truth_of_mask(element: Element) -> Code {
    match element {
        Element::Single => Code::EVEX_Vpmovm2d_zmm_kr,
        Element::Double => Code::EVEX_Vpmovm2q_zmm_kr,
    }
}

/// Every instruction of the table.
pub(crate) fn every_code() -> Vec<Code> {
    use Operation::*;
    let operations = [
        Add,
        Sub,
        Mul,
        Div,
        And,
        AndNot,
        Or,
        Xor,
        AddBits,
        SubBits,
        EqualBits,
        Least,
        Compare(0),
        Sqrt,
        Fma,
        Select,
        ShiftLeft(0),
        ShiftRight(0),
        Widen,
        Narrow,
        UpperHalf,
        Join,
        Min,
        Max,
        Lows,
        Highs,
        Firsts,
        Seconds,
        Pieces(0),
        FromIntegers,
        FromBytes,
        FromWords,
        Load,
        LoadHalf,
        Spread,
        SpreadFirst,
    ];
    let mut all = Vec::new();
    for element in [Element::Single, Element::Double] {
        all.push(truth_of_mask(element));
        for width in [VectorWidth::Bits256, VectorWidth::Bits512] {
            all.extend(operations.map(|operation| operation.code(element, width)));
            all.extend([FmaForm::F132, FmaForm::F213, FmaForm::F231].map(|form| form.code(element, width)));
            all.extend([Portion::Whole, Portion::Half, Portion::Least].map(|extent| store(extent, element, width)));
            all.extend([truths(element, width), gather(width)]);
        }
    }
    all
}

/// A portion of a vector register.
pub(super) fn register(number: u8, extent: Portion, width: VectorWidth) -> Register {
    let first = match (extent, width) {
        (Portion::Whole, VectorWidth::Bits512) => Register::ZMM0,
        (Portion::Whole, _) | (Portion::Half, VectorWidth::Bits512) => Register::YMM0,
        _ => Register::XMM0,
    };
    first + u32::from(number)
}
