//! Indexes a SPIR-V module: types with their sizes, constants with their values, names, decorations, functions.
//!
//! SPIR-V requires definitions before uses, so one pass over the global instructions finds every size and every value
//! without recursion. A module that breaks this rule is rejected.

use std::collections::HashMap;

use rspirv::binary::{Consumer, ParseAction, parse_words};
use rspirv::dr::{Instruction, ModuleHeader, Operand};
use rspirv::spirv::{
    Capability, Decoration, Dim, ExecutionMode, ExecutionModel, ImageFormat, Op, StorageClass, Word,
};

use crate::ir::{MemberKind, ShaderStage};

/// The operands of an `OpType...` instruction. Words such as `element` and `pointee` are ids of other types.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Type {
    Bool,
    Int {
        bits: u32,
        signed: bool,
    },
    Float {
        bits: u32,
    },
    Vector {
        element: Word,
        count: u32,
    },
    Matrix {
        column: Word,
        columns: u32,
    },
    Array {
        element: Word,
        length: u64,
    },
    RuntimeArray {
        element: Word,
    },
    Struct {
        members: Vec<Word>,
    },
    Pointer {
        class: StorageClass,
        pointee: Word,
    },
    Image {
        dim: Dim,
        arrayed: bool,
        multisampled: bool,
        sampled: u32,
        format: ImageFormat,
    },
    /// Any other type, with the name of its instruction.
    Other(&'static str),
}

#[derive(Clone, Debug)]
pub(super) struct TypeInfo {
    pub kind: Type,
    /// Bytes in a block, runtime arrays excluded. `None` without an explicit layout, and for matrices, whose stride
    /// belongs to the member.
    pub laid_out: Option<u64>,
    /// Bytes and alignment by std430, for variables without an explicit layout; `None` for types without a size.
    pub natural: Option<(u64, u64)>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Variable {
    pub id: Word,
    pub class: StorageClass,
    pub pointee: Word,
}

#[derive(Debug, Default)]
pub(super) struct Function {
    pub parameters: Vec<Word>,
    pub body: Vec<Instruction>,
}

#[derive(Debug)]
pub(super) struct Module {
    pub stage: ShaderStage,
    pub entry: Word,
    /// The variables that the entry point lists.
    pub interface: Vec<Word>,
    pub local_size: [u32; 3],
    pub capabilities: Vec<Capability>,
    /// SPIR-V extensions that the module declares.
    pub extensions: Vec<String>,
    /// GLSL extensions that the source text requires.
    pub source_extensions: Vec<String>,
    /// Type of each constant, by the constant's id.
    pub constants: HashMap<Word, Word>,
    /// Value of each integer constant, by the constant's id.
    pub values: HashMap<Word, u64>,
    pub types: HashMap<Word, TypeInfo>,
    /// Types that consist of 32-bit scalars of one kind only, with this kind.
    pub scalars: HashMap<Word, MemberKind>,
    pub variables: Vec<Variable>,
    pub functions: HashMap<Word, Function>,
    /// Ids of non-semantic extended instruction sets, such as debug information.
    pub non_semantic: Vec<Word>,
    names: HashMap<Named, String>,
    decorations: HashMap<Named, Vec<(Decoration, Option<u32>)>>,
}

/// An id, or a member of the type with that id.
type Named = (Word, Option<u32>);

/// Returns operand `index`, which must be an id.
pub(super) fn id(instruction: &Instruction, index: usize) -> Result<Word, String> {
    let operand = instruction.operands.get(index).and_then(Operand::id_ref_any);
    operand.ok_or_else(|| format!("Op{} lacks operand {index}", instruction.class.opname))
}

fn literal(instruction: &Instruction, index: usize) -> Result<u32, String> {
    match instruction.operands.get(index) {
        Some(Operand::LiteralBit32(value)) => Ok(*value),
        _ => Err(format!("Op{} lacks number {index}", instruction.class.opname)),
    }
}

/// Checks that every instruction ends within the module. If one does not and has a string operand, the parser slices
/// out of bounds and panics.
fn check_lengths(spirv: &[u32]) -> Result<(), String> {
    const HEADER: usize = 5;
    let mut at = HEADER;
    while at < spirv.len() {
        let words = (spirv[at] >> 16) as usize;
        if words == 0 || words > spirv.len() - at {
            return Err("this is not SPIR-V: an instruction does not end".into());
        }
        at += words;
    }
    Ok(())
}

struct Collect(Vec<Instruction>);

impl Consumer for Collect {
    fn initialize(&mut self) -> ParseAction {
        ParseAction::Continue
    }
    fn finalize(&mut self) -> ParseAction {
        ParseAction::Continue
    }
    fn consume_header(&mut self, _: ModuleHeader) -> ParseAction {
        ParseAction::Continue
    }
    fn consume_instruction(&mut self, instruction: Instruction) -> ParseAction {
        self.0.push(instruction);
        ParseAction::Continue
    }
}

impl Module {
    pub fn parse(spirv: &[u32]) -> Result<Module, String> {
        check_lengths(spirv)?;
        let mut collect = Collect(Vec::new());
        parse_words(spirv, &mut collect).map_err(|error| format!("this is not SPIR-V: {error}"))?;
        let mut module = Module {
            stage: ShaderStage::Compute,
            entry: 0,
            interface: Vec::new(),
            local_size: [1; 3],
            capabilities: Vec::new(),
            extensions: Vec::new(),
            source_extensions: Vec::new(),
            constants: HashMap::new(),
            values: HashMap::new(),
            types: HashMap::new(),
            scalars: HashMap::new(),
            variables: Vec::new(),
            functions: HashMap::new(),
            non_semantic: Vec::new(),
            names: HashMap::new(),
            decorations: HashMap::new(),
        };
        let mut entries = 0;
        let mut local_size_ids = None;
        let mut workgroup_size = None;
        let mut constants = Constants::default();
        let mut function: Option<(Word, Function)> = None;
        for instruction in collect.0 {
            let i = &instruction;
            match i.class.opcode {
                Op::Function => {
                    let id = i.result_id.ok_or("a function has no id")?;
                    if function.replace((id, Function::default())).is_some() {
                        return Err("a function is nested in a function".into());
                    }
                }
                Op::FunctionEnd => {
                    let (id, function) = function.take().ok_or("a function ends that did not begin")?;
                    module.functions.insert(id, function);
                }
                _ if function.is_some() => {
                    if let (Some((_, function)), Op::FunctionParameter) = (&mut function, i.class.opcode) {
                        function.parameters.push(i.result_id.ok_or("a parameter has no id")?);
                    } else if let Some((_, function)) = &mut function {
                        function.body.push(instruction);
                    }
                }
                Op::EntryPoint => {
                    entries += 1;
                    module.entry_point(i)?;
                }
                Op::ExecutionMode => {
                    if let Some(Operand::ExecutionMode(ExecutionMode::LocalSize)) = i.operands.get(1) {
                        module.local_size = [literal(i, 2)?, literal(i, 3)?, literal(i, 4)?];
                    }
                }
                Op::ExecutionModeId => {
                    if let Some(Operand::ExecutionMode(ExecutionMode::LocalSizeId)) = i.operands.get(1) {
                        local_size_ids = Some([id(i, 2)?, id(i, 3)?, id(i, 4)?]);
                    }
                }
                Op::Capability => {
                    if let Some(Operand::Capability(capability)) = i.operands.first() {
                        if matches!(
                            capability,
                            Capability::Addresses
                                | Capability::PhysicalStorageBufferAddresses
                                | Capability::VariablePointers
                                | Capability::VariablePointersStorageBuffer
                        ) {
                            return Err(format!(
                                "shaders with {capability:?} are not supported: what they touch cannot be known"
                            ));
                        }
                        module.capabilities.push(*capability);
                    }
                }
                Op::Extension | Op::SourceExtension => {
                    if let Some(Operand::LiteralString(name)) = i.operands.first() {
                        let list = if i.class.opcode == Op::Extension {
                            &mut module.extensions
                        } else {
                            &mut module.source_extensions
                        };
                        list.push(name.clone());
                    }
                }
                Op::ExtInstImport => {
                    let name = i.operands.first();
                    if matches!(name, Some(Operand::LiteralString(n)) if n.starts_with("NonSemantic.")) {
                        module.non_semantic.extend(i.result_id);
                    }
                }
                Op::Name => {
                    if let Some(Operand::LiteralString(name)) = i.operands.get(1) {
                        module.names.insert((id(i, 0)?, None), name.clone());
                    }
                }
                Op::MemberName => {
                    if let Some(Operand::LiteralString(name)) = i.operands.get(2) {
                        module.names.insert((id(i, 0)?, Some(literal(i, 1)?)), name.clone());
                    }
                }
                Op::Decorate => module.decorate(id(i, 0)?, None, &i.operands[1..]),
                Op::MemberDecorate => module.decorate(id(i, 0)?, Some(literal(i, 1)?), &i.operands[2..]),
                Op::Variable => {
                    let id = i.result_id.ok_or("a variable has no id")?;
                    let pointer = i.result_type.ok_or("a variable has no type")?;
                    let Type::Pointer { class, pointee } = module.type_of(pointer)?.kind else {
                        return Err("a variable's type is not a pointer".into());
                    };
                    module.variables.push(Variable { id, class, pointee });
                }
                op if op.is_constant() => {
                    if let (Op::SpecConstantComposite | Op::ConstantComposite, Some(id)) = (op, i.result_id)
                        && module.decoration(id, None, Decoration::BuiltIn).is_some()
                    {
                        // gl_WorkGroupSize is the only built-in constant.
                        workgroup_size = Some([self::id(i, 0)?, self::id(i, 1)?, self::id(i, 2)?]);
                    }
                    constants.add(i, &module);
                    module.constants.extend(i.result_id.zip(i.result_type));
                }
                op if op.is_type() => {
                    // OpTypeForwardPointer has no result, and cannot occur in the supported types.
                    if let Some(id) = i.result_id {
                        let info = module.type_info(i, id, &constants)?;
                        module.scalars.extend(module.scalar_of(&info.kind).map(|scalar| (id, scalar)));
                        // A redefinition could refer to itself, and following it would not end.
                        if module.types.insert(id, info).is_some() {
                            return Err(format!("the type {id} is defined twice"));
                        }
                    }
                }
                _ => {}
            }
        }
        if function.is_some() {
            return Err("a function does not end".into());
        }
        if entries != 1 {
            return Err(format!("the module has {entries} entry points, not one"));
        }
        if !module.functions.contains_key(&module.entry) {
            return Err("the entry point is not a function of the module".into());
        }
        if let Some(ids) = workgroup_size.or(local_size_ids) {
            for (size, id) in module.local_size.iter_mut().zip(ids) {
                let value = constants.value(id)?;
                *size = value.try_into().map_err(|_| format!("a workgroup is {value} invocations wide"))?;
            }
        }
        module.values = constants.0;
        Ok(module)
    }

    fn entry_point(&mut self, instruction: &Instruction) -> Result<(), String> {
        self.stage = match instruction.operands.first() {
            Some(Operand::ExecutionModel(ExecutionModel::Vertex)) => ShaderStage::Vertex,
            Some(Operand::ExecutionModel(ExecutionModel::Fragment)) => ShaderStage::Fragment,
            Some(Operand::ExecutionModel(ExecutionModel::GLCompute)) => ShaderStage::Compute,
            Some(Operand::ExecutionModel(other)) => {
                return Err(format!("shaders of the kind {other:?} are not supported"));
            }
            _ => return Err("the entry point has no stage".into()),
        };
        self.entry = id(instruction, 1)?;
        self.interface = instruction.operands.iter().skip(3).filter_map(Operand::id_ref_any).collect();
        Ok(())
    }

    fn decorate(&mut self, id: Word, member: Option<u32>, operands: &[Operand]) {
        if let Some(Operand::Decoration(decoration)) = operands.first() {
            let value = match operands.get(1) {
                Some(Operand::LiteralBit32(value)) => Some(*value),
                Some(Operand::BuiltIn(built_in)) => Some(*built_in as u32),
                _ => None,
            };
            self.decorations.entry((id, member)).or_default().push((*decoration, value));
        }
    }

    pub fn name(&self, id: Word, member: Option<u32>) -> &str {
        self.names.get(&(id, member)).map_or("", String::as_str)
    }

    /// Returns the first number of a decoration: `Some(None)` if it has none, `None` without the decoration.
    pub fn decoration(&self, id: Word, member: Option<u32>, decoration: Decoration) -> Option<Option<u32>> {
        let all = self.decorations.get(&(id, member))?;
        all.iter().find(|(kind, _)| *kind == decoration).map(|(_, value)| *value)
    }

    pub fn number(&self, id: Word, member: Option<u32>, decoration: Decoration) -> Option<u32> {
        self.decoration(id, member, decoration).flatten()
    }

    pub fn type_of(&self, id: Word) -> Result<&TypeInfo, String> {
        self.types.get(&id).ok_or_else(|| format!("id {id} is used as a type and is not one"))
    }

    /// Returns the kind of a type's 32-bit scalars; `None` if it contains others, or scalars of several kinds.
    fn scalar_of(&self, kind: &Type) -> Option<MemberKind> {
        match kind {
            Type::Float { bits: 32 } => Some(MemberKind::Float),
            Type::Int { bits: 32, signed } => Some(if *signed { MemberKind::Int } else { MemberKind::Uint }),
            Type::Vector { element: part, .. }
            | Type::Matrix { column: part, .. }
            | Type::Array { element: part, .. }
            | Type::RuntimeArray { element: part } => self.scalars.get(part).copied(),
            Type::Struct { members } => {
                let mut kinds = members.iter().map(|member| self.scalars.get(member).copied());
                let first = kinds.next()??;
                kinds.all(|kind| kind == Some(first)).then_some(first)
            }
            _ => None,
        }
    }

    fn type_info(&self, i: &Instruction, this: Word, constants: &Constants) -> Result<TypeInfo, String> {
        let too_large = || "a type is too large".to_string();
        let simple = |kind, bits: u32| {
            let bytes = u64::from(bits.div_ceil(8));
            TypeInfo { kind, laid_out: Some(bytes), natural: Some((bytes, bytes.max(1))) }
        };
        let opaque = |kind| TypeInfo { kind, laid_out: None, natural: None };
        Ok(match i.class.opcode {
            Op::TypeBool => TypeInfo { laid_out: None, ..simple(Type::Bool, 32) },
            Op::TypeInt => {
                let bits = literal(i, 0)?;
                simple(Type::Int { bits, signed: literal(i, 1)? != 0 }, bits)
            }
            Op::TypeFloat => {
                let bits = literal(i, 0)?;
                simple(Type::Float { bits }, bits)
            }
            Op::TypeVector => {
                let (element, count) = (id(i, 0)?, literal(i, 1)?);
                let (bytes, align) =
                    self.type_of(element)?.natural.ok_or("a vector of something without size")?;
                let size = bytes.checked_mul(count.into()).ok_or_else(too_large)?;
                let slots = if count == 2 { 2 } else { 4 };
                TypeInfo {
                    kind: Type::Vector { element, count },
                    laid_out: Some(size),
                    natural: Some((size, align.checked_mul(slots).ok_or_else(too_large)?)),
                }
            }
            Op::TypeMatrix => {
                let (column, columns) = (id(i, 0)?, literal(i, 1)?);
                let (bytes, align) =
                    self.type_of(column)?.natural.ok_or("a matrix of something without size")?;
                let stride = bytes.checked_next_multiple_of(align).ok_or_else(too_large)?;
                let size = stride.checked_mul(columns.into()).ok_or_else(too_large)?;
                // In a block the size depends on the member's MatrixStride, see OpTypeStruct.
                TypeInfo {
                    kind: Type::Matrix { column, columns },
                    laid_out: None,
                    natural: Some((size, align)),
                }
            }
            Op::TypeArray => {
                let (element, length) = (id(i, 0)?, constants.value(id(i, 1)?)?);
                let natural = match self.type_of(element)?.natural {
                    Some((bytes, align)) => {
                        let stride = bytes.checked_next_multiple_of(align).ok_or_else(too_large)?;
                        Some((stride.checked_mul(length).ok_or_else(too_large)?, align))
                    }
                    None => None,
                };
                let stride = self.number(this, None, Decoration::ArrayStride);
                let laid_out =
                    stride.map(|stride| u64::from(stride).checked_mul(length).ok_or_else(too_large));
                TypeInfo { kind: Type::Array { element, length }, laid_out: laid_out.transpose()?, natural }
            }
            Op::TypeRuntimeArray => {
                let element = id(i, 0)?;
                self.type_of(element)?;
                TypeInfo { kind: Type::RuntimeArray { element }, laid_out: Some(0), natural: None }
            }
            Op::TypeStruct => {
                let members = i.operands.iter().filter_map(Operand::id_ref_any).collect::<Vec<_>>();
                let mut natural = Some((0u64, 1u64));
                let mut laid_out = Some(0u64);
                for (index, member) in members.iter().enumerate() {
                    let info = self.type_of(*member)?;
                    natural = match (natural, info.natural) {
                        (Some((size, align)), Some((bytes, member_align))) => {
                            let start = size.checked_next_multiple_of(member_align).ok_or_else(too_large)?;
                            let end = start.checked_add(bytes).ok_or_else(too_large)?;
                            Some((end, align.max(member_align)))
                        }
                        _ => None,
                    };
                    let offset = self.number(this, Some(index as u32), Decoration::Offset);
                    let bytes = self.member_bytes(this, index as u32, info)?;
                    laid_out = match (laid_out, offset, bytes) {
                        (Some(size), Some(offset), Some(bytes)) => {
                            Some(size.max(bytes.checked_add(offset.into()).ok_or_else(too_large)?))
                        }
                        _ => None,
                    };
                }
                if let Some((size, align)) = natural {
                    natural = Some((size.checked_next_multiple_of(align).ok_or_else(too_large)?, align));
                }
                TypeInfo { kind: Type::Struct { members }, laid_out, natural }
            }
            Op::TypePointer => {
                let Some(Operand::StorageClass(class)) = i.operands.first() else {
                    return Err("a pointer has no storage class".into());
                };
                opaque(Type::Pointer { class: *class, pointee: id(i, 1)? })
            }
            Op::TypeImage => match i.operands.as_slice() {
                [_, Operand::Dim(dim), _, _, _, _, Operand::ImageFormat(format), ..] => opaque(Type::Image {
                    dim: *dim,
                    arrayed: literal(i, 3)? != 0,
                    multisampled: literal(i, 4)? != 0,
                    sampled: literal(i, 5)?,
                    format: *format,
                }),
                _ => return Err("an image type is malformed".into()),
            },
            _ => opaque(Type::Other(i.class.opname)),
        })
    }

    /// Returns the bytes of a struct's member; `None` without an explicit layout.
    fn member_bytes(&self, owner: Word, member: u32, info: &TypeInfo) -> Result<Option<u64>, String> {
        let Type::Matrix { column, columns } = info.kind else { return Ok(info.laid_out) };
        let Some(stride) = self.number(owner, Some(member), Decoration::MatrixStride) else {
            return Ok(None);
        };
        let Type::Vector { count: rows, .. } = self.type_of(column)?.kind else {
            return Err("a matrix has no columns".into());
        };
        let row_major = self.decoration(owner, Some(member), Decoration::RowMajor).is_some();
        Ok(Some(u64::from(stride) * u64::from(if row_major { rows } else { columns })))
    }
}

/// Values of integer constants; specialization constants have their defaults.
#[derive(Default)]
struct Constants(HashMap<Word, u64>);

impl Constants {
    fn add(&mut self, i: &Instruction, module: &Module) {
        let Some(id) = i.result_id else { return };
        let signed_or_bits = i.result_type.and_then(|t| module.types.get(&t)).map(|t| &t.kind);
        let value = match i.class.opcode {
            Op::Constant | Op::SpecConstant => match i.operands.first() {
                Some(Operand::LiteralBit32(value)) => Some(u64::from(*value)),
                Some(Operand::LiteralBit64(value)) => Some(*value),
                _ => None,
            },
            Op::ConstantNull => Some(0),
            Op::SpecConstantOp => self.operation(i),
            _ => None,
        };
        if let (Some(value), Some(Type::Int { bits, .. })) = (value, signed_or_bits) {
            let mask = if *bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
            self.0.insert(id, value & mask);
        }
    }

    /// Evaluates common integer operations. `None` for others, which is an error only if the value is needed.
    fn operation(&self, i: &Instruction) -> Option<u64> {
        let Some(Operand::LiteralSpecConstantOpInteger(op)) = i.operands.first() else { return None };
        let operand = |index: usize| self.0.get(&i.operands.get(index)?.id_ref_any()?).copied();
        let (a, b) = (operand(1)?, operand(2));
        match op {
            Op::IAdd => Some(a.wrapping_add(b?)),
            Op::ISub => Some(a.wrapping_sub(b?)),
            Op::IMul => Some(a.wrapping_mul(b?)),
            Op::UDiv => a.checked_div(b?),
            Op::UMod => a.checked_rem(b?),
            // Without negative operands, signed and unsigned division agree.
            Op::SDiv if a >> 31 == 0 && b? >> 31 == 0 => a.checked_div(b?),
            Op::SRem | Op::SMod if a >> 31 == 0 && b? >> 31 == 0 => a.checked_rem(b?),
            Op::ShiftLeftLogical => a.checked_shl(u32::try_from(b?).ok()?),
            Op::ShiftRightLogical => a.checked_shr(u32::try_from(b?).ok()?),
            Op::BitwiseAnd => Some(a & b?),
            Op::BitwiseOr => Some(a | b?),
            Op::BitwiseXor => Some(a ^ b?),
            _ => None,
        }
    }

    fn value(&self, id: Word) -> Result<u64, String> {
        let value = self.0.get(&id).copied();
        value.ok_or_else(|| "a size is given by a constant whose value cannot be computed".to_string())
    }
}
