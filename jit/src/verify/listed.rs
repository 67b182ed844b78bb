//! The list of instructions that kernels may contain. None of them traps, none reads or writes but its operands.

use std::sync::LazyLock;

use iced_x86::{Code, Instruction, Mnemonic, OpKind, Register};

use crate::x86;

/// Instructions on general registers, and control flow.
#[rustfmt::skip]
const GENERAL: &[Code] = { use Code::*; &[
    Mov_r64_rm64, Mov_rm64_r64, Mov_rm64_imm32, Mov_r64_imm64, Mov_r32_rm32, Mov_rm32_r32, Mov_r32_imm32,
    Mov_rm32_imm32, Mov_rm16_r16, Mov_rm8_r8, Movzx_r32_rm8, Movzx_r32_rm16, Movzx_r64_rm8, Movzx_r64_rm16,
    Lea_r64_m, Lea_r32_m, Add_r64_rm64, Add_rm64_r64, Add_rm64_imm8, Add_rm64_imm32, Add_RAX_imm32,
    Add_r32_rm32, Sub_r64_rm64, Sub_rm64_r64, Sub_rm64_imm8, Sub_rm64_imm32, Sub_RAX_imm32, Sub_r32_rm32,
    Sbb_r64_rm64, Sbb_rm64_r64, Sbb_r32_rm32, Sbb_rm32_r32, Neg_rm64, Neg_rm32, Neg_rm8, Imul_r64_rm64,
    Imul_r64_rm64_imm8, Imul_r64_rm64_imm32, Imul_r32_rm32_imm32, Shl_rm64_imm8, Shl_rm32_imm8, Shr_rm32_imm8,
    Popcnt_r32_rm32, And_r64_rm64, And_rm64_r64, And_rm64_imm8, And_rm64_imm32, And_RAX_imm32, And_r32_rm32,
    And_rm32_r32, And_rm32_imm8, And_rm32_imm32, And_EAX_imm32, And_r8_rm8, And_rm8_r8, And_rm8_imm8,
    And_AL_imm8, Or_r64_rm64, Or_rm64_r64, Or_r32_rm32, Or_rm32_r32, Or_r8_rm8, Or_rm8_r8, Xor_r64_rm64,
    Xor_rm64_r64, Xor_r32_rm32, Xor_rm32_r32, Xor_rm32_imm8, Xor_r8_rm8, Xor_rm8_r8, Xor_rm8_imm8, Xor_AL_imm8,
    Cmp_r64_rm64, Cmp_rm64_r64, Cmp_rm64_imm8, Cmp_rm64_imm32, Cmp_RAX_imm32, Cmp_r32_rm32, Cmp_rm32_r32,
    Cmp_rm32_imm8, Cmp_rm32_imm32, Cmp_EAX_imm32, Cmp_rm8_imm8, Cmp_AL_imm8, Test_rm64_r64, Test_rm32_r32,
    Test_rm8_r8, Test_rm8_imm8, Test_AL_imm8, Test_rm32_imm32, Test_EAX_imm32, Push_r64, Pop_r64, Call_rm64,
    Retnq, Jmp_rel32_64, VEX_Vzeroupper, VEX_Kmovw_r32_kr, VEX_Kmovw_kr_r32, Prefetcht0_m8,
] };

/// Vector instructions of Cranelift in legacy SSE encoding.
#[rustfmt::skip]
const LEGACY: &[Mnemonic] = { use Mnemonic::*; &[
    Addps, Addpd, Addss, Addsd, Subps, Subpd, Subss, Subsd, Mulps, Mulpd, Mulss, Mulsd, Divps, Divpd, Divss,
    Divsd, Sqrtps, Sqrtpd, Sqrtss, Sqrtsd, Minss, Minsd, Maxss, Maxsd, Minps, Minpd, Maxps, Maxpd, Andps, Andpd,
    Andnps, Andnpd, Orps, Orpd, Xorps, Xorpd, Cmpps, Cmppd, Cmpss, Cmpsd, Ucomiss, Ucomisd, Cvtdq2ps, Cvtdq2pd,
    Cvtps2pd, Cvtpd2ps, Cvtss2sd, Cvtsd2ss, Cvtsi2sd, Paddd, Paddq, Psubd, Psubq, Pand, Pandn, Por, Pxor,
    Pcmpeqd, Pcmpeqq, Pcmpgtd, Pcmpgtq, Pslld, Psllq, Psrld, Psrlq, Blendvps, Blendvpd, Pblendvb, Movaps,
    Movapd, Movups, Movupd, Movdqa, Movdqu, Movss, Movsd, Movd, Movq, Movddup, Movlhps, Movhlps, Movmskps,
    Movmskpd, Insertps, Pinsrd, Pinsrq, Pextrd, Pextrq, Pmovzxbw, Pmovzxwd, Pshufb, Pshufd, Shufps, Shufpd,
    Unpcklps, Unpcklpd, Unpckhpd, Punpcklbw, Punpcklwd, Punpckldq, Punpcklqdq, Punpckhqdq,
] };

/// Vector instructions of Cranelift in VEX encoding: those of [`LEGACY`], and those that exist in VEX only.
#[rustfmt::skip]
const EXTENDED: &[Mnemonic] = { use Mnemonic::*; &[
    Vaddps, Vaddpd, Vaddss, Vaddsd, Vsubps, Vsubpd, Vsubss, Vsubsd, Vmulps, Vmulpd, Vmulss, Vmulsd, Vdivps,
    Vdivpd, Vdivss, Vdivsd, Vsqrtps, Vsqrtpd, Vsqrtss, Vsqrtsd, Vminss, Vminsd, Vmaxss, Vmaxsd, Vminps, Vminpd,
    Vmaxps, Vmaxpd, Vandps, Vandpd, Vandnps, Vandnpd, Vorps, Vorpd, Vxorps, Vxorpd, Vcmpps, Vcmppd, Vcmpss,
    Vcmpsd, Vucomiss, Vucomisd, Vcvtdq2ps, Vcvtdq2pd, Vcvtps2pd, Vcvtpd2ps, Vcvtss2sd, Vcvtsd2ss, Vcvtsi2sd,
    Vpaddd, Vpaddq, Vpsubd, Vpsubq, Vpand, Vpandn, Vpor, Vpxor, Vpcmpeqd, Vpcmpeqq, Vpcmpgtd, Vpcmpgtq, Vpslld,
    Vpsllq, Vpsrld, Vpsrlq, Vblendvps, Vblendvpd, Vpblendvb, Vmovaps, Vmovapd, Vmovups, Vmovupd, Vmovdqa,
    Vmovdqu, Vmovss, Vmovsd, Vmovd, Vmovq, Vmovddup, Vmovlhps, Vmovhlps, Vmovmskps, Vmovmskpd, Vinsertps,
    Vpinsrd, Vpinsrq, Vpextrd, Vpextrq, Vpmovzxbw, Vpmovzxwd, Vpshufb, Vpshufd, Vshufps, Vshufpd, Vunpcklps,
    Vunpcklpd, Vunpckhpd, Vpunpcklbw, Vpunpcklwd, Vpunpckldq, Vpunpcklqdq, Vpunpckhqdq, Vbroadcastss, Vbroadcastsd,
    Vpbroadcastd, Vpbroadcastq, Vfmadd132ps, Vfmadd132pd, Vfmadd132ss, Vfmadd132sd, Vfmadd213ps, Vfmadd213pd,
    Vfmadd213ss, Vfmadd213sd, Vfmsub132ps, Vfmsub132pd, Vfmsub132ss, Vfmsub132sd, Vfmsub213ps, Vfmsub213pd,
    Vfmsub213ss, Vfmsub213sd, Vfnmadd132ps, Vfnmadd132pd, Vfnmadd132ss, Vfnmadd132sd, Vfnmadd213ps,
    Vfnmadd213pd, Vfnmadd213ss, Vfnmadd213sd, Vfnmsub132ps, Vfnmsub132pd, Vfnmsub132ss, Vfnmsub132sd,
    Vfnmsub213ps, Vfnmsub213pd, Vfnmsub213ss, Vfnmsub213sd,
] };

/// A set of numbers.
struct Table(Vec<bool>);

impl Table {
    fn of(numbers: impl Iterator<Item = usize>) -> Table {
        let mut table = Table(Vec::new());
        for number in numbers {
            table.0.resize(table.0.len().max(number + 1), false);
            table.0[number] = true;
        }
        table
    }

    fn has(&self, number: usize) -> bool {
        self.0.get(number).is_some_and(|is_there| *is_there)
    }
}

/// Whether kernels may contain the instruction.
pub(super) fn is_allowed(instruction: &Instruction) -> bool {
    static CODES: LazyLock<Table> =
        LazyLock::new(|| Table::of(GENERAL.iter().copied().chain(x86::every_code()).map(|code| code as usize)));
    static VECTOR: LazyLock<Table> =
        LazyLock::new(|| Table::of(LEGACY.iter().chain(EXTENDED).map(|name| *name as usize)));
    let is_plain = instruction.segment_prefix() == Register::None
        && !instruction.has_lock_prefix()
        && !instruction.has_rep_prefix()
        && !instruction.has_repne_prefix();
    // String instructions share mnemonics with others; so do those on MMX registers.
    let is_operand_plain = |operand: u32| match instruction.op_kind(operand) {
        OpKind::Register => {
            let register = instruction.op_register(operand);
            register.is_gpr() || register.is_vector_register() || register.is_k()
        }
        kind => kind == OpKind::Memory || kind == OpKind::Immediate8,
    };
    let mnemonic = instruction.mnemonic();
    let is_vector = || VECTOR.has(mnemonic as usize) && (0..instruction.op_count()).all(is_operand_plain);
    is_plain && (is_vector() || is_conditional(mnemonic) || CODES.has(instruction.code() as usize))
}

/// Whether it is a conditional jump, move or byte set.
pub(super) fn is_conditional(mnemonic: Mnemonic) -> bool {
    use Mnemonic::*;
    matches!(mnemonic, Ja | Jae | Jb | Jbe | Je | Jg | Jge | Jl | Jle | Jne | Jnp | Jns | Jp | Js)
        || is_conditional_move(mnemonic)
        || matches!(
            mnemonic,
            Seta | Setae | Setb | Setbe | Sete | Setg | Setge | Setl | Setle | Setne | Setnp | Setns | Setp | Sets
        )
}

pub(super) fn is_conditional_move(mnemonic: Mnemonic) -> bool {
    use Mnemonic::*;
    matches!(
        mnemonic,
        Cmova
            | Cmovae
            | Cmovb
            | Cmovbe
            | Cmove
            | Cmovg
            | Cmovge
            | Cmovl
            | Cmovle
            | Cmovne
            | Cmovnp
            | Cmovns
            | Cmovp
            | Cmovs
    )
}

/// Whether it compares numbers in vector registers into the flags.
pub(super) fn compares_numbers(mnemonic: Mnemonic) -> bool {
    use Mnemonic::*;
    matches!(mnemonic, Ucomiss | Ucomisd | Vucomiss | Vucomisd)
}

/// Whether it preserves the flags.
pub(super) fn keeps_flags(mnemonic: Mnemonic) -> bool {
    use Mnemonic::*;
    let is_moved = matches!(mnemonic, Mov | Movzx | Lea | Movaps | Movups | Movdqu | Movsd | Movss);
    is_moved || matches!(mnemonic, Vmovaps | Vmovups | Vmovupd | Vmovdqu | Vmovsd | Vmovss) || is_conditional(mnemonic)
}

/// Whether its memory operand must be at a multiple of its size.
pub(super) fn wants_alignment(mnemonic: Mnemonic) -> bool {
    use Mnemonic::*;
    match mnemonic {
        Movups | Movupd | Movdqu => false,
        Vmovaps | Vmovapd | Vmovdqa => true,
        _ => LEGACY.contains(&mnemonic),
    }
}
