//! Builds extended BPF programs (RFC 9669), with labels in place of distances.

use std::os::fd::{AsRawFd, BorrowedFd};

use super::super::socket::sys::bpf::Instruction;

// Classes.
const LD: u8 = 0x00;
const LDX: u8 = 0x01;
const ST: u8 = 0x02;
const STX: u8 = 0x03;
const JMP: u8 = 0x05;
const JMP32: u8 = 0x06;
const ALU64: u8 = 0x07;
const ALU: u8 = 0x04;
// Modes.
const IMM: u8 = 0x00;
const MEM: u8 = 0x60;
const ATOMIC: u8 = 0xC0;
/// The operand is a register, not a number.
const X: u8 = 0x08;
/// Brings a number into network byte order.
const TO_NETWORK: u8 = 0xD8;
/// In the source register of a 64-bit load: the number is the descriptor of a map.
const PSEUDO_MAP_FD: u8 = 1;

/// A register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Register(u8);

/// The result of a call. The kernel takes it as the result of the program.
pub(super) const R0: Register = Register(0);
/// The first argument of a call. Calls change `R1` to `R5`.
pub(super) const R1: Register = Register(1);
pub(super) const R2: Register = Register(2);
pub(super) const R3: Register = Register(3);
pub(super) const R4: Register = Register(4);
pub(super) const R5: Register = Register(5);
/// Calls leave `R6` to `R9` as they are.
pub(super) const R6: Register = Register(6);
pub(super) const R7: Register = Register(7);
pub(super) const R8: Register = Register(8);
pub(super) const R9: Register = Register(9);
/// The end of the stack, which lies below it.
pub(super) const STACK: Register = Register(10);

/// The width of a load or store.
#[derive(Clone, Copy, Debug)]
pub(super) enum Width {
    U8 = 0x10,
    U16 = 0x08,
    U32 = 0x00,
    U64 = 0x18,
}

/// What a step calculates.
#[derive(Clone, Copy, Debug)]
pub(super) enum Alu {
    Add = 0x00,
    Sub = 0x10,
    Mul = 0x20,
    Div = 0x30,
    Or = 0x40,
    And = 0x50,
    Shl = 0x60,
    Shr = 0x70,
    Xor = 0xA0,
    Mov = 0xB0,
}

/// When a jump is made. Numbers have no sign.
#[derive(Clone, Copy, Debug)]
pub(super) enum If {
    Equal = 0x10,
    Greater = 0x20,
    GreaterOrEqual = 0x30,
    AnyBit = 0x40,
    NotEqual = 0x50,
    Less = 0xA0,
}

/// A register or a number. A number is extended with its sign.
#[derive(Clone, Copy, Debug)]
pub(super) enum Operand {
    Register(Register),
    Number(i32),
}

impl From<Register> for Operand {
    fn from(register: Register) -> Self {
        Self::Register(register)
    }
}

impl From<i32> for Operand {
    fn from(number: i32) -> Self {
        Self::Number(number)
    }
}

/// A function of the kernel.
#[derive(Clone, Copy, Debug)]
pub(super) enum Function {
    MapLookUp = 1,
    Nanoseconds = 5,
    StoreOctets = 9,
    ReplaceChecksum = 11,
    Redirect = 23,
}

/// A place in a program.
#[derive(Clone, Copy, Debug)]
pub(super) struct Label(usize);

/// A program that is being built.
#[derive(Default)]
pub(super) struct Program {
    steps: Vec<Instruction>,
    /// The step of each label, once it is known.
    labels: Vec<Option<usize>>,
    /// Which steps jump, and to where.
    jumps: Vec<(usize, Label)>,
}

impl Program {
    /// A new label, which has to be [placed](Self::place) once.
    pub(super) fn label(&mut self) -> Label {
        self.labels.push(None);
        Label(self.labels.len() - 1)
    }

    /// The label stands for the next step.
    pub(super) fn place(&mut self, label: Label) {
        self.labels[label.0] = Some(self.steps.len());
    }

    pub(super) fn load(&mut self, width: Width, to: Register, from: Register, offset: i16) {
        self.step(LDX | MEM | width as u8, to, from, offset, 0);
    }

    pub(super) fn store(&mut self, width: Width, to: Register, offset: i16, from: Register) {
        self.step(STX | MEM | width as u8, to, from, offset, 0);
    }

    pub(super) fn store_number(&mut self, width: Width, to: Register, offset: i16, number: i32) {
        self.step(ST | MEM | width as u8, to, R0, offset, number);
    }

    /// Adds a register to 64 bits of memory in one piece.
    pub(super) fn add_to_memory(&mut self, to: Register, offset: i16, from: Register) {
        self.step(STX | ATOMIC | Width::U64 as u8, to, from, offset, 0);
    }

    /// Exchanges a register and 64 bits of memory in one piece.
    pub(super) fn exchange(&mut self, with: Register, offset: i16, register: Register) {
        self.step(STX | ATOMIC | Width::U64 as u8, with, register, offset, 0xE1);
    }

    /// Calculates with 64 bits.
    pub(super) fn alu(&mut self, alu: Alu, register: Register, operand: impl Into<Operand>) {
        self.operate(ALU64 | alu as u8, register, operand.into(), 0);
    }

    /// Calculates with 32 bits. The upper ones are zero then.
    pub(super) fn alu32(&mut self, alu: Alu, register: Register, operand: impl Into<Operand>) {
        self.operate(ALU | alu as u8, register, operand.into(), 0);
    }

    pub(super) fn copy(&mut self, to: Register, operand: impl Into<Operand>) {
        self.alu(Alu::Mov, to, operand);
    }

    /// Reads 16 bits in network byte order as a number, or the other way round.
    pub(super) fn swap16(&mut self, register: Register) {
        self.step(ALU | TO_NETWORK, register, R0, 0, 16);
    }

    /// Sets a register to any number.
    pub(super) fn set(&mut self, register: Register, number: u64) {
        self.step(LD | IMM | Width::U64 as u8, register, R0, 0, number as i32);
        self.step(0, R0, R0, 0, (number >> 32) as i32);
    }

    /// Sets a register to a map.
    pub(super) fn map(&mut self, register: Register, map: BorrowedFd<'_>) {
        let code = LD | IMM | Width::U64 as u8;
        self.step(code, register, Register(PSEUDO_MAP_FD), 0, map.as_raw_fd());
        self.step(0, R0, R0, 0, 0);
    }

    pub(super) fn jump(&mut self, label: Label) {
        self.jumps.push((self.steps.len(), label));
        self.step(JMP, R0, R0, 0, 0);
    }

    /// Jumps if this holds for all 64 bits.
    pub(super) fn jump_if(
        &mut self,
        condition: If,
        register: Register,
        operand: impl Into<Operand>,
        label: Label,
    ) {
        self.jumps.push((self.steps.len(), label));
        self.operate(JMP | condition as u8, register, operand.into(), 0);
    }

    /// Jumps if this holds for the lower 32 bits.
    pub(super) fn jump_if32(
        &mut self,
        condition: If,
        register: Register,
        operand: impl Into<Operand>,
        label: Label,
    ) {
        self.jumps.push((self.steps.len(), label));
        self.operate(JMP32 | condition as u8, register, operand.into(), 0);
    }

    pub(super) fn call(&mut self, function: Function) {
        self.step(JMP | 0x80, R0, R0, 0, function as i32);
    }

    pub(super) fn exit(&mut self) {
        self.step(JMP | 0x90, R0, R0, 0, 0);
    }

    /// The program, with distances in place of labels.
    pub(super) fn finish(mut self) -> Vec<Instruction> {
        for (step, label) in self.jumps {
            let target = self.labels[label.0].expect("every label has its place");
            self.steps[step].offset = (target as isize - step as isize - 1) as i16;
        }
        self.steps
    }

    fn operate(&mut self, code: u8, register: Register, operand: Operand, offset: i16) {
        match operand {
            Operand::Register(from) => self.step(code | X, register, from, offset, 0),
            Operand::Number(number) => self.step(code, register, R0, offset, number),
        }
    }

    fn step(&mut self, code: u8, to: Register, from: Register, offset: i16, number: i32) {
        self.steps.push(Instruction::new(code, to.0, from.0, offset, number));
    }
}
