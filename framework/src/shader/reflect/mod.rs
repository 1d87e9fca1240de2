//! Reads bindings, push constants, workgroup size, stage inputs and outputs from a SPIR-V module.
//!
//! A graph names the resource of each block of a shader, but not the accesses. These come from the code, so they cannot
//! be out of date. rspirv parses the module, [`module`] indexes the instructions, [`access`] follows pointers through
//! functions, and this file assembles the result.

mod access;
mod features;
mod module;
#[cfg(all(test, feature = "glslang"))]
mod tests;
mod words;

use std::collections::HashSet;

use rspirv::spirv::{BuiltIn, Decoration, Dim, ImageFormat, Op, StorageClass, Word};

use self::access::{Accesses, accesses, reachable};
use self::module::{Module, Type, Variable};
use crate::ir::{
    Format, LIVE_BINDING, LIVE_BLOCK, Member, MemberKind, PushBlock, ReflectedBinding, ReflectedKind,
    Reflection, Varying,
};

/// Reads the module of one shader stage with one entry point.
///
/// Fails, with a message, on invalid modules, features that no backend enables, pointers with unknown targets,
/// descriptor arrays without a length, bindings that graphs do not support, and more than 64 KiB of local
/// variables. Supported are storage buffers, uniform blocks, and two-dimensional storage images in a [`Format`] or
/// without a declared format.
pub fn reflect(spirv: &[u32]) -> Result<Reflection, String> {
    let module = Module::parse(spirv)?;
    let is_resource = |v: &&Variable| {
        matches!(v.class, StorageClass::StorageBuffer | StorageClass::Uniform | StorageClass::UniformConstant)
    };
    let resources: HashSet<Word> = module.variables.iter().filter(is_resource).map(|v| v.id).collect();
    let accesses = accesses(&module, &resources)?;

    let mut bindings = Vec::new();
    for variable in module.variables.iter().filter(|v| accesses.touched.contains(&v.id)) {
        bindings.push(binding(&module, variable, &accesses)?);
    }
    bindings.sort_by(|a, b| (a.set, a.binding, &a.name).cmp(&(b.set, b.binding, &b.name)));

    let mut shared_bytes = 0u64;
    for variable in module.variables.iter().filter(|v| v.class == StorageClass::Workgroup) {
        let natural = module.type_of(variable.pointee)?.natural;
        let (bytes, align) = natural.ok_or("a shared variable has a type without size")?;
        let start = shared_bytes.checked_next_multiple_of(align).ok_or("shared memory is too large")?;
        shared_bytes = start.checked_add(bytes).ok_or("shared memory is too large")?;
    }

    check_locals(&module)?;
    let push = module.variables.iter().find(|v| v.class == StorageClass::PushConstant);
    let push = push.map(|variable| {
        let used = |member| accesses.uses_member(variable.id, member);
        let (bytes, members) = block(&module, variable.pointee, "the push constants", used)?;
        Ok::<_, String>(PushBlock { bytes, members })
    });

    let built_in = |v: &Variable| module.number(v.id, None, Decoration::BuiltIn);
    let uses_input = |any: [BuiltIn; 2]| {
        let found =
            module.variables.iter().filter(|v| any.iter().any(|one| built_in(v) == Some(*one as u32)));
        found.map(|v| v.id).any(|input| accesses.members.iter().any(|(variable, _)| *variable == input))
    };
    Ok(Reflection {
        stage: module.stage,
        local_size: module.local_size,
        shared_bytes: small(shared_bytes, "shared memory")?,
        bindings,
        push: push.transpose()?,
        inputs: varyings(&module, StorageClass::Input)?,
        outputs: varyings(&module, StorageClass::Output)?,
        uses_position: uses_position(&module, &accesses),
        ignores_rows: uses_input([BuiltIn::WorkgroupId, BuiltIn::GlobalInvocationId])
            && !uses_input([BuiltIn::NumWorkgroups; 2]),
        features: features::features(&module, &accesses)?,
    })
}

/// Maximum bytes of local and global variables per invocation. lavapipe compiles larger ones for minutes, in gigabytes
/// of memory, and GPUs multiply them by the number of invocations in flight.
const MAX_LOCAL_BYTES: u64 = 64 << 10;

/// Rejects a module with more than [`MAX_LOCAL_BYTES`] of variables: globals, and locals of reachable functions.
/// Read-only variables do not count.
fn check_locals(module: &Module) -> Result<(), String> {
    let mut locals: Vec<(u64, Word)> = Vec::new();
    let mut add = |variable: Word, pointee: Word| {
        // glslang copies a constant array at each access with a computed index. Drivers store it once.
        if module.decoration(variable, None, Decoration::NonWritable).is_none() {
            locals.push((module.type_of(pointee)?.natural.map_or(0, |(bytes, _)| bytes), variable));
        }
        Ok::<_, String>(())
    };
    for variable in module.variables.iter().filter(|v| v.class == StorageClass::Private) {
        add(variable.id, variable.pointee)?;
    }
    for function in reachable(module)? {
        for i in module.functions[&function].body.iter().filter(|i| i.class.opcode == Op::Variable) {
            let (variable, pointer) = i.result_id.zip(i.result_type).ok_or("a variable has no type")?;
            if let Type::Pointer { pointee, .. } = module.type_of(pointer)?.kind {
                add(variable, pointee)?;
            }
        }
    }
    let bytes = locals.iter().fold(0, |sum: u64, (bytes, _)| sum.saturating_add(*bytes));
    let Some((_, largest)) = locals.iter().max().filter(|_| bytes > MAX_LOCAL_BYTES) else { return Ok(()) };
    let most = MAX_LOCAL_BYTES >> 10;
    let largest = module.name(*largest, None);
    Err(format!(
        "expected at most {most} KiB of local variables (on any device), found {bytes} bytes, the most in `{largest}`"
    ))
}

/// Returns true if reachable code mentions the built-in `Position`, a variable or a member of a block.
fn uses_position(module: &Module, accesses: &Accesses) -> bool {
    let is_position =
        |id, member| module.number(id, member, Decoration::BuiltIn) == Some(BuiltIn::Position as u32);
    let mut outputs = module.variables.iter().filter(|v| v.class == StorageClass::Output);
    outputs.any(|v| match module.types.get(&v.pointee).map(|info| &info.kind) {
        Some(Type::Struct { members }) => (0..members.len() as u32)
            .any(|member| is_position(v.pointee, Some(member)) && accesses.uses_member(v.id, member)),
        _ => is_position(v.id, None) && accesses.members.contains(&(v.id, None)),
    })
}

fn small(value: u64, what: &str) -> Result<u32, String> {
    value.try_into().map_err(|_| format!("{what} has {value} bytes, which is too large"))
}

fn binding(module: &Module, variable: &Variable, accesses: &Accesses) -> Result<ReflectedBinding, String> {
    let mut element = variable.pointee;
    let mut count = 1u64;
    let own_name = || {
        let names = [module.name(variable.id, None), module.name(element_of(module, variable.pointee), None)];
        names.into_iter().find(|name| !name.is_empty()).unwrap_or("(without a name)").to_string()
    };
    loop {
        match module.type_of(element)?.kind {
            Type::Array { element: inner, length } => {
                element = inner;
                count = count.checked_mul(length).ok_or("an array of bindings is too large")?;
            }
            Type::RuntimeArray { .. } => {
                return Err(format!("`{}` is an array of bindings without a length", own_name()));
            }
            _ => break,
        }
    }
    let (name, kind) = match &module.type_of(element)?.kind {
        Type::Struct { members } => {
            // Before SPIR-V 1.3, this decoration distinguished storage buffers from uniform blocks.
            let old = module.decoration(element, None, Decoration::BufferBlock).is_some();
            let name = match module.name(element, None) {
                "" => own_name(),
                name => name.to_string(),
            };
            let kind = if variable.class == StorageClass::StorageBuffer || old {
                storage_buffer(module, element, members, &name)?
            } else {
                // In an array of blocks, access chains select the element first, so every member counts as used.
                let used = |member| variable.pointee != element || accesses.uses_member(variable.id, member);
                let (bytes, members) = block(module, element, &format!("`{name}`"), used)?;
                ReflectedKind::UniformBuffer { bytes, members }
            };
            (name, kind)
        }
        Type::Image { dim, arrayed, multisampled, sampled, format } => {
            let name = own_name();
            let unsupported = match (sampled, dim) {
                (_, Dim::DimSubpassData) => Some("an input attachment"),
                (2, Dim::DimBuffer) => Some("a storage texel buffer"),
                (_, Dim::DimBuffer) => Some("a uniform texel buffer"),
                (2, Dim::Dim2D) if *arrayed => Some("an array of layers"),
                (2, Dim::Dim2D) if *multisampled => Some("a multisampled image"),
                (2, Dim::Dim2D) => None,
                (2, _) => Some("a storage image that is not two-dimensional"),
                _ => Some("a sampled image"),
            };
            if let Some(unsupported) = unsupported {
                return Err(cannot_bind(&name, unsupported));
            }
            let format = image_format(*format).map_err(|format| {
                format!("the image `{name}` has the format {format}, which graphs do not support")
            })?;
            (name, ReflectedKind::StorageImage { format })
        }
        Type::Other(kind) => {
            let described = match *kind {
                "TypeSampledImage" => "a sampled image",
                "TypeSampler" => "a sampler",
                "TypeAccelerationStructureKHR" => "an acceleration structure",
                other => other.trim_start_matches("Type"),
            };
            return Err(cannot_bind(&own_name(), described));
        }
        other => return Err(format!("`{}` is bound and has the type {other:?}", own_name())),
    };
    let binding = module.number(variable.id, None, Decoration::Binding);
    if binding == Some(LIVE_BINDING) && name != LIVE_BLOCK {
        return Err(format!("`{name}` is binding {LIVE_BINDING}, which is reserved for live parameters"));
    }
    Ok(ReflectedBinding {
        set: module.number(variable.id, None, Decoration::DescriptorSet).unwrap_or(0),
        binding: binding.ok_or_else(|| format!("`{name}` has no `layout(binding = ...)`"))?,
        count: count.try_into().map_err(|_| format!("the array of `{name}` is too large"))?,
        reads: accesses.reads.contains(&variable.id),
        writes: accesses.writes.contains(&variable.id),
        atomics: accesses.atomics.contains(&variable.id),
        atomics_only: accesses.atomics.contains(&variable.id) && !accesses.plain.contains(&variable.id),
        writes_first: accesses.written_first.contains(&variable.id),
        words: match kind {
            ReflectedKind::StorageBuffer { .. } => words::of_block(module, element)?,
            _ => vec![],
        },
        scalar: module.scalars.get(&element).copied().unwrap_or(MemberKind::Other),
        name,
        kind,
    })
}

fn cannot_bind(name: &str, what: &str) -> String {
    format!("`{name}` is {what}; graphs bind storage buffers, uniform blocks and storage images")
}

/// Returns the element type of an array, through all dimensions; other types unchanged.
fn element_of(module: &Module, mut id: Word) -> Word {
    while let Some(Type::Array { element, .. } | Type::RuntimeArray { element }) =
        module.types.get(&id).map(|t| &t.kind)
    {
        id = *element;
    }
    id
}

fn storage_buffer(
    module: &Module,
    block: Word,
    members: &[Word],
    name: &str,
) -> Result<ReflectedKind, String> {
    let bytes = module.type_of(block)?.laid_out.ok_or_else(|| format!("`{name}` has no layout"))?;
    let fixed_bytes = small(bytes, name)?;
    let Some(last) = members.last() else {
        return Ok(ReflectedKind::StorageBuffer { stride: None, fixed_bytes });
    };
    let stride = match module.type_of(*last)?.kind {
        Type::RuntimeArray { .. } => {
            let stride = module.number(*last, None, Decoration::ArrayStride);
            Some(stride.ok_or_else(|| format!("the array in `{name}` has no stride"))?)
        }
        _ => None,
    };
    Ok(ReflectedKind::StorageBuffer { stride, fixed_bytes })
}

fn block(
    module: &Module,
    block: Word,
    what: &str,
    used: impl Fn(u32) -> bool,
) -> Result<(u32, Vec<Member>), String> {
    let info = module.type_of(block)?;
    let Type::Struct { members: types } = &info.kind else { return Err(format!("{what} are not a block")) };
    let mut members = Vec::new();
    for (index, id) in types.iter().enumerate() {
        let index = index as u32;
        let offset = module.number(block, Some(index), Decoration::Offset);
        members.push(Member {
            name: module.name(block, Some(index)).to_string(),
            offset: offset.ok_or_else(|| format!("{what} have no layout"))?,
            kind: words::scalar(&module.type_of(*id)?.kind),
            used: used(index),
        });
    }
    let bytes = info.laid_out.ok_or_else(|| format!("{what} have no layout"))?;
    Ok((small(bytes, what)?, members))
}

/// Returns the format of a storage image; `None` if undeclared. The error names an unsupported format.
fn image_format(format: ImageFormat) -> Result<Option<Format>, String> {
    Ok(Some(match format {
        ImageFormat::Unknown => return Ok(None),
        ImageFormat::Rgba8 => Format::Rgba8Unorm,
        ImageFormat::Rgba16f => Format::Rgba16Float,
        ImageFormat::Rgba32f => Format::Rgba32Float,
        ImageFormat::R32ui => Format::R32Uint,
        ImageFormat::R32f => Format::R32Float,
        other => return Err(format!("{other:?}").to_lowercase()),
    }))
}

/// Returns the inputs or outputs with a location; built-ins have none.
fn varyings(module: &Module, class: StorageClass) -> Result<Vec<Varying>, String> {
    let mut varyings = Vec::new();
    for variable in module.variables.iter().filter(|v| v.class == class && module.interface.contains(&v.id)) {
        let base = module.number(variable.id, None, Decoration::Location);
        let mut add = |name: &str, location: u32, id: Word| {
            let glsl_type = glsl_type(module, id)?;
            varyings.push(Varying { name: name.to_string(), location, glsl_type });
            Ok::<_, String>(())
        };
        if let Type::Struct { members } = &module.type_of(variable.pointee)?.kind {
            // An interface block. Members without explicit locations are consecutive.
            let mut next = base;
            for (index, member) in members.iter().enumerate() {
                let index = index as u32;
                next = module.number(variable.pointee, Some(index), Decoration::Location).or(next);
                let Some(location) = next else { continue };
                add(module.name(variable.pointee, Some(index)), location, *member)?;
                let taken = u32::try_from(locations(module, *member)?).unwrap_or(u32::MAX);
                next = Some(location.saturating_add(taken));
            }
        } else if let Some(location) = base {
            add(module.name(variable.id, None), location, variable.pointee)?;
        }
    }
    varyings.sort_by(|a, b| (a.location, &a.name).cmp(&(b.location, &b.name)));
    Ok(varyings)
}

/// Returns the number of locations of a type: one per started 16 bytes of each scalar or vector in it.
fn locations(module: &Module, id: Word) -> Result<u64, String> {
    let info = module.type_of(id)?;
    Ok(match &info.kind {
        Type::Matrix { column, columns } => u64::from(*columns).saturating_mul(locations(module, *column)?),
        Type::Array { element, length } => length.saturating_mul(locations(module, *element)?),
        Type::Struct { members } => members.iter().try_fold(0, |sum: u64, member| {
            Ok::<_, String>(sum.saturating_add(locations(module, *member)?))
        })?,
        _ => info.natural.map_or(1, |(bytes, _)| bytes.div_ceil(16)),
    })
}

fn glsl_type(module: &Module, mut id: Word) -> Result<String, String> {
    let mut suffix = String::new();
    while let Type::Array { element, length } = module.type_of(id)?.kind {
        suffix += &format!("[{length}]");
        id = element;
    }
    let name = match &module.type_of(id)?.kind {
        Type::Vector { element, count } => {
            format!("{}vec{count}", scalar_names(&module.type_of(*element)?.kind)[1])
        }
        Type::Matrix { column, columns } => match module.type_of(*column)?.kind {
            Type::Vector { element, count } => {
                let [_, prefix] = scalar_names(&module.type_of(element)?.kind);
                if count == *columns {
                    format!("{prefix}mat{columns}")
                } else {
                    format!("{prefix}mat{columns}x{count}")
                }
            }
            _ => return Err("a matrix has no columns".into()),
        },
        Type::Struct { .. } => module.name(id, None).to_string(),
        scalar => scalar_names(scalar)[0].clone(),
    };
    Ok(name + &suffix)
}

/// Returns the name of a scalar type, and the prefix of its vectors' names.
fn scalar_names(scalar: &Type) -> [String; 2] {
    let plain = |names: [&str; 2]| names.map(str::to_string);
    match scalar {
        Type::Bool => plain(["bool", "b"]),
        Type::Int { bits: 32, signed: true } => plain(["int", "i"]),
        Type::Int { bits: 32, signed: false } => plain(["uint", "u"]),
        Type::Int { bits, signed: true } => [format!("int{bits}_t"), format!("i{bits}")],
        Type::Int { bits, signed: false } => [format!("uint{bits}_t"), format!("u{bits}")],
        Type::Float { bits: 32 } => plain(["float", ""]),
        Type::Float { bits: 64 } => plain(["double", "d"]),
        Type::Float { bits } => [format!("float{bits}_t"), format!("f{bits}")],
        other => [format!("{other:?}"), format!("{other:?} ")],
    }
}
