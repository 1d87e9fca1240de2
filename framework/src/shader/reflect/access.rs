//! Finds the resources that code reachable from an entry point loads from and stores to.
//!
//! In SPIR-V's logical addressing every pointer comes from variables, through access chains, copies and function
//! arguments. Each pointer id gets the set of variables that it may point into, its *roots*: first the variables
//! themselves, then by following instructions and calls to a fixed point. The analysis is context-insensitive: an
//! access to a parameter is an access to every argument of any reachable call. Code in untaken branches counts as
//! reachable.

use std::collections::{BTreeSet, HashMap, HashSet};

use rspirv::dr::{Instruction, Operand};
use rspirv::spirv::{Op, Word};

use super::module::{Module, Type, id};

#[derive(Debug, Default)]
pub(super) struct Accesses {
    pub reads: HashSet<Word>,
    pub writes: HashSet<Word>,
    pub atomics: HashSet<Word>,
    /// Variables that instructions other than atomics access.
    pub plain: HashSet<Word>,
    /// Variables whose first access is a store, in code order: the entry point, then the functions that it calls.
    pub written_first: HashSet<Word>,
    /// Variables that reachable code mentions, even if only to query an array's length or an image's size.
    pub touched: HashSet<Word>,
    /// Uses of variables, each with the first index of an access chain, if it is constant. The index is a block's
    /// member or an array's element; `None` for all other uses.
    pub members: HashSet<(Word, Option<u64>)>,
}

impl Accesses {
    /// Returns true if the code may use a member of a block variable that is not an array.
    pub fn uses_member(&self, variable: Word, member: u32) -> bool {
        [None, Some(member.into())].iter().any(|member| self.members.contains(&(variable, *member)))
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Effect {
    Nothing,
    Read,
    Write,
    Both,
}

pub(super) fn accesses(module: &Module, variables: &HashSet<Word>) -> Result<Accesses, String> {
    let functions = reachable(module)?;
    let mut roots: Roots = variables.iter().map(|v| (*v, BTreeSet::from([*v]))).collect();
    let mut returned = Roots::new();
    loop {
        let mut changed = false;
        for function in &functions {
            for i in &module.functions[function].body {
                changed |= propagate(module, *function, i, &mut roots, &mut returned)?;
            }
        }
        if !changed {
            break;
        }
    }
    let mut accesses = Accesses::default();
    let declared: HashSet<Word> = module.variables.iter().map(|v| v.id).collect();
    for function in &functions {
        for i in &module.functions[function].body {
            note(module, i, &roots, &mut accesses)?;
            let used = i.operands.iter().filter_map(Operand::id_ref_any).filter(|id| declared.contains(id));
            accesses.members.extend(used.map(|variable| (variable, selected(module, i, variable))));
        }
    }
    Ok(accesses)
}

/// Returns the first index of an access chain into `variable`; `None` if it is not constant, or for another use.
fn selected(module: &Module, i: &Instruction, variable: Word) -> Option<u64> {
    if !matches!(i.class.opcode, Op::AccessChain | Op::InBoundsAccessChain) || id(i, 0).ok()? != variable {
        return None;
    }
    module.values.get(&id(i, 1).ok()?).copied()
}

type Roots = HashMap<Word, BTreeSet<Word>>;

/// Returns the reachable functions, in breadth-first order from the entry point.
pub(super) fn reachable(module: &Module) -> Result<Vec<Word>, String> {
    let mut functions = vec![module.entry];
    let mut seen = HashSet::from([module.entry]);
    let mut next = 0;
    while let Some(function) = functions.get(next) {
        next += 1;
        let body = &module.functions.get(function).ok_or("a function is called that does not exist")?.body;
        let calls = body.iter().filter(|i| i.class.opcode == Op::FunctionCall);
        for called in calls.map(|i| id(i, 0)).collect::<Result<Vec<_>, _>>()? {
            if seen.insert(called) {
                functions.push(called);
            }
        }
    }
    Ok(functions)
}

/// Returns true if the result refers to the resource of the first operand and the instruction accesses nothing.
fn leads_on(opcode: Op) -> bool {
    matches!(
        opcode,
        Op::AccessChain
            | Op::InBoundsAccessChain
            | Op::PtrAccessChain
            | Op::InBoundsPtrAccessChain
            | Op::CopyObject
            | Op::ImageTexelPointer
            | Op::SampledImage
            | Op::Image
    )
}

/// Propagates roots from an instruction's operands to its result, or into the called function. Returns true if any
/// roots were added.
fn propagate(
    module: &Module,
    function: Word,
    i: &Instruction,
    roots: &mut Roots,
    returned: &mut Roots,
) -> Result<bool, String> {
    let mut sources = Vec::new();
    match i.class.opcode {
        opcode if leads_on(opcode) => sources.push(id(i, 0)?),
        // Loading an image yields a handle and reads nothing.
        Op::Load if is_opaque(module, i)? => sources.push(id(i, 0)?),
        Op::Select => sources.extend([id(i, 1)?, id(i, 2)?]),
        Op::Phi => sources.extend(i.operands.iter().step_by(2).filter_map(Operand::id_ref_any)),
        Op::ReturnValue => {
            let value = roots.get(&id(i, 0)?).cloned();
            return Ok(value.is_some_and(|value| extend(returned, function, &value)));
        }
        Op::FunctionCall => {
            let callee = id(i, 0)?;
            let parameters = &module.functions[&callee].parameters;
            let mut changed = false;
            for (index, parameter) in parameters.iter().enumerate() {
                if let Some(argument) = roots.get(&id(i, index + 1)?).cloned() {
                    changed |= extend(roots, *parameter, &argument);
                }
            }
            if let (Some(result), Some(value)) = (i.result_id, returned.get(&callee)) {
                changed |= extend(roots, result, value);
            }
            return Ok(changed);
        }
        _ => return Ok(false),
    }
    let mut changed = false;
    for source in sources {
        if let (Some(result), Some(from)) = (i.result_id, roots.get(&source).cloned()) {
            changed |= extend(roots, result, &from);
        }
    }
    Ok(changed)
}

fn extend(roots: &mut Roots, id: Word, more: &BTreeSet<Word>) -> bool {
    let set = roots.entry(id).or_default();
    let before = set.len();
    set.extend(more);
    set.len() > before
}

/// Returns true if a load yields a handle (an image, a sampler) rather than data.
fn is_opaque(module: &Module, load: &Instruction) -> Result<bool, String> {
    let result = load.result_type.ok_or("a load has no type")?;
    Ok(matches!(module.type_of(result)?.kind, Type::Image { .. } | Type::Other(_) | Type::Pointer { .. }))
}

fn note(module: &Module, i: &Instruction, roots: &Roots, accesses: &mut Accesses) -> Result<(), String> {
    let opcode = i.class.opcode;
    if opcode == Op::ExtInst && module.non_semantic.contains(&id(i, 0)?) {
        return Ok(());
    }
    for (index, operand) in i.operands.iter().enumerate() {
        let Some(targets) = operand.id_ref_any().and_then(|id| roots.get(&id)) else { continue };
        accesses.touched.extend(targets);
        let effect = match (opcode, index) {
            (Op::Load, 0) if is_opaque(module, i)? => Effect::Nothing,
            (Op::Load | Op::AtomicLoad, 0) => Effect::Read,
            (Op::Store | Op::AtomicStore | Op::AtomicFlagClear, 0) => Effect::Write,
            (Op::CopyMemory | Op::CopyMemorySized, 0) => Effect::Write,
            (Op::CopyMemory | Op::CopyMemorySized, 1) => Effect::Read,
            (Op::ImageRead | Op::ImageSparseRead | Op::ImageFetch, 0) => Effect::Read,
            (Op::ImageWrite, 0) => Effect::Write,
            (opcode, 0) if leads_on(opcode) => Effect::Nothing,
            (Op::Select | Op::Phi | Op::FunctionCall | Op::ReturnValue, _) => Effect::Nothing,
            (Op::ArrayLength, 0) => Effect::Nothing,
            (
                Op::ImageQuerySize | Op::ImageQuerySizeLod | Op::ImageQueryLevels | Op::ImageQuerySamples,
                0,
            ) => Effect::Nothing,
            // Other atomics, and any other instruction with a pointer: assume a read and a write.
            _ => Effect::Both,
        };
        if effect == Effect::Write {
            let new = targets.iter().filter(|v| !accesses.reads.contains(v) && !accesses.writes.contains(v));
            accesses.written_first.extend(new);
        }
        if matches!(effect, Effect::Read | Effect::Both) {
            accesses.reads.extend(targets);
        }
        if matches!(effect, Effect::Write | Effect::Both) {
            accesses.writes.extend(targets);
        }
        if effect != Effect::Nothing {
            let atomic = format!("{opcode:?}").starts_with("Atomic");
            if atomic { accesses.atomics.extend(targets) } else { accesses.plain.extend(targets) }
        }
    }
    Ok(())
}
