use super::*;
use crate::limits::SubgroupLimits;
use crate::testing::*;

fn limits() -> Limits {
    Limits {
        facts: DeviceFacts {
            max_storage_bytes: 128 << 20,
            features: Features::empty(),
            ..DeviceFacts::typical(8)
        },
        heap_bytes: 4 << 30,
        subgroup: SubgroupLimits { min_size: 8, max_size: 8, selectable: true, max_per_group: 32 },
        ..Limits::desktop()
    }
}

fn said(alter: impl FnOnce(&mut Plan, &mut Limits)) -> String {
    let (mut plan, mut limits) = (plan(), limits());
    alter(&mut plan, &mut limits);
    let text = check(&plan, &limits).err().map(|error| error.to_string()).unwrap_or_default();
    text.lines().next().unwrap_or_default().to_string()
}

fn buffer(plan: &mut Plan, id: ResourceId, count: u64) {
    plan.resources[id.index()].shape = Shape::Buffer { stride: 4, count };
}

fn touch(resource: ResourceId, accesses: Accesses) -> Use {
    Use { resource, stages: Stages::COMPUTE, accesses, layout: None, discards: false }
}

#[test]
fn a_plan_within_the_limits_is_accepted() {
    assert_eq!(said(|_, _| {}), "");
}

#[test]
fn sizes_are_compared_in_mebibytes_and_name_the_resource() {
    assert_eq!(
        said(|plan, _| buffer(plan, WORDS, 40_000_000)),
        "the size of `words`, bound as a storage buffer by pass `scan[0]` exceeds the device's limit: expected at most \
         128.0 MiB, found 152.6 MiB"
    );
    assert_eq!(
        said(|plan, _| buffer(plan, ARGS, 1 << 30)),
        "the size of buffer `args` exceeds the device's limit: expected at most 2048.0 MiB, found 4096.0 MiB"
    );
    assert!(
        said(|plan, _| buffer(plan, CAMERA, 65536)).contains("`camera`, bound as a uniform block by pass")
    );
    assert_eq!(
        said(|plan, limits| {
            buffer(plan, SPLATS, 5000);
            limits.heap_bytes = 40_000
        }),
        "the size of the resources that must be on the device (the largest is `splats` with 20000 bytes) exceeds the \
         device's limit: expected at most 40000 bytes, found 40772 bytes"
    );
}

#[test]
fn more_of_anything_than_the_limit_is_refused_with_both_numbers() {
    let (mut plan, mut limits) = (plan(), limits());
    let mut refused = |alter: fn(&mut Plan, &mut Limits), what: &str, available: u64, needed: u64| {
        (plan, limits) = (crate::testing::plan(), self::limits());
        alter(&mut plan, &mut limits);
        let Err(BackendError::Limit(limit)) = check(&plan, &limits) else { panic!("{what} is not refused") };
        assert_eq!((limit.what.as_str(), limit.available, limit.needed), (what, available, needed));
    };
    refused(|_, l| l.facts.max_push_bytes = 4, "the size of the push constants of pass `clear`", 4, 8);
    let what = "the number of workgroups [4, 1, 1] of pass `scan[0]` in x";
    refused(|_, l| l.facts.max_groups[0] = 3, what, 3, 4);
    let what = "the number of invocations in a workgroup [64, 1, 1] of shader `scan.comp`";
    refused(|_, l| l.facts.max_invocations = 32, what, 32, 64);
    let what = "the workgroup size [64, 1, 1] of shader `scan.comp` in x";
    refused(|_, l| l.max_local_size[0] = 63, what, 63, 64);
    refused(|_, l| l.facts.shared_bytes = 512, "the shared memory of shader `scan.comp`", 512, 1024);
    let what = "the longer side of image `color` (64 x 32 pixels)";
    refused(|_, l| l.facts.max_image_size = 63, what, 63, 64);
    let what = "the number of storage buffers bound by pass `splat`";
    refused(|_, l| l.max_storage_buffers = 1, what, 1, 2);
    refused(|_, l| l.facts.max_targets = 0, "the number of targets of pass `splat`", 0, 1);
}

#[test]
fn what_exceeds_a_limit_is_refused_at_the_declaration_of_its_pass_or_resource() {
    let (mut plan, limits) = (plan(), limits());
    plan.resources[COLOR.index()].origin = Origin { file: "a.ron".into(), line: 3, column: 5 };
    plan.passes[1].origin = Origin { file: "b.ron".into(), line: 7, column: 9 };
    let narrow = |facts| Limits { facts, ..limits.clone() };
    let refused = |limits: &Limits, place: &str| {
        let error = check(&plan, limits).expect_err("the limit is exceeded");
        assert!(error.to_string().ends_with(place), "{error}");
        too_large(&plan, &limits.facts).map(|(error, origin)| error.at(origin)) == Some(error)
    };
    assert!(
        refused(&narrow(DeviceFacts { max_image_size: 63, ..limits.facts }), "\n --> a.ron:3:5"),
        "without a device"
    );
    assert!(
        !refused(&narrow(DeviceFacts { max_groups: [1; 3], ..limits.facts }), "\n --> b.ron:7:9"),
        "the linker refuses this"
    );
}

#[test]
fn work_that_no_device_ends_in_a_reasonable_time_is_refused() {
    let huge = said(|plan, _| {
        let shader = plan.passes.iter().find_map(|pass| match pass.work {
            Work::Dispatch { shader, .. } => Some(shader),
            _ => None,
        });
        plan.passes[1].work =
            Work::Dispatch { shader: shader.expect("a dispatch"), groups: Groups::Direct([65535, 65535, 8]) };
    });
    assert!(huge.starts_with("pass `scan[0]` has more invocations than any device finishes"), "{huge}");
    assert!(huge.contains("at most 1099511627776"), "{huge}");
    let vertices = said(|plan, _| {
        let draw = plan.passes.iter_mut().find_map(|pass| match &mut pass.work {
            Work::Draw { call, .. } => Some(call),
            _ => None,
        });
        *draw.expect("a draw") = DrawCall::Direct { vertices: u32::MAX, instances: u32::MAX };
    });
    assert!(vertices.starts_with("pass `splat` has more vertices than any device finishes"), "{vertices}");
}

#[test]
fn a_shader_with_subgroups_whose_size_is_not_certain_is_refused_with_what_would_help() {
    let several = SubgroupLimits { min_size: 32, max_size: 64, selectable: true, max_per_group: 8 };
    let with = |limits: SubgroupLimits, local_size: [u32; 3]| {
        said(|plan, own| {
            (own.subgroup, own.facts) = (limits, DeviceFacts::typical(32));
            for shader in &mut plan.shaders {
                if shader.reflection.stage == ShaderStage::Compute {
                    shader.reflection.features = Features::SUBGROUP_BASIC;
                    shader.reflection.local_size = local_size;
                }
            }
        })
    };
    assert_eq!(with(several, [64, 1, 1]), "");
    let planned_for = |lanes: i64, features: Features| {
        said(|plan, own| {
            own.facts.features = Features::all();
            plan.facts.insert("device.subgroup_size".into(), Value::Int(lanes));
            plan.shaders[0].reflection.features = features;
        })
    };
    assert_eq!(planned_for(8, Features::SUBGROUP_BASIC), "");
    assert_eq!(
        planned_for(32, Features::SUBGROUP_BASIC),
        "shader `scan.comp` uses subgroup operations: expected a plan for the device's subgroups of 8 lanes, found one for 32"
    );
    assert_eq!(planned_for(32, Features::empty()), "", "no shader depends on the size");
    let odd = with(several, [16, 16, 1]);
    assert!(odd.contains("subgroups of 32 lanes, but the driver may run it with 32 to 64"), "{odd}");
    assert!(odd.contains("multiple of 32") && odd.contains("[16, 16, 1]"), "{odd}");
    let too_many = with(several, [512, 1, 1]);
    assert!(too_many.contains("at most 256 invocations"), "{too_many}");
    let fixed = SubgroupLimits { selectable: false, ..several };
    assert!(
        with(fixed, [64, 1, 1]).contains("does not let pipelines request"),
        "{}",
        with(fixed, [64, 1, 1])
    );
    let one = SubgroupLimits { max_size: 32, ..fixed };
    assert_eq!(with(one, [16, 16, 1]), "");
}

fn changed(image: ResourceId, old: Layout, new: Layout) -> LayoutChange {
    LayoutChange { image, old, new, before: PassId(1), handover: false }
}

fn needs(first: PassId, second: PassId, resource: ResourceId, alias: Option<ResourceId>) -> Dependency {
    Dependency {
        hazard: Hazard::ReadAfterWrite,
        first,
        second,
        since: Since::Same,
        resource,
        alias,
        bytes: 0..4,
        changes_layout: false,
        masks: Masks::new(
            (Stages::COMPUTE, Accesses::STORAGE_WRITE),
            (Stages::COMPUTE, Accesses::STORAGE_READ),
        ),
    }
}

#[test]
fn a_plan_that_contradicts_itself_is_refused_and_never_a_panic() {
    type Alteration = fn(&mut Plan);
    let alterations: [(&str, Alteration); 30] = [
        ("shader `scan.comp` has no code", |plan| plan.shaders[0].spirv = Default::default()),
        ("pass 9", |plan| plan.frame[0] = PassId(9)),
        ("runs twice", |plan| plan.frame[0] = PassId(0)),
        ("needs 64-bit floats, which the device does not have", |plan| {
            plan.shaders[0].reflection.features = Features::FLOAT64;
        }),
        ("resource 77", |plan| plan.output = ResourceId(77)),
        ("resource 77", |plan| plan.passes[1].bindings[0].resource = ResourceId(77)),
        ("resource 77", |plan| {
            plan.passes[1].uses.push(touch(ResourceId(77), Accesses::STORAGE_WRITE));
        }),
        ("`args` is not the only resource with the history `past`", |plan| {
            for id in [WORDS, ARGS] {
                plan.resources[id.index()].history = Some("past".to_string());
            }
        }),
        ("not a Compute shader", |plan| {
            plan.passes[1].work = Work::Dispatch { shader: ShaderId(1), groups: Groups::Direct([1; 3]) };
        }),
        ("0 elements", |plan| buffer(plan, WORDS, 0)),
        ("not a StorageBuffer", |plan| plan.passes[1].bindings[0].resource = COLOR),
        ("12 bytes at byte 24", |plan| {
            let groups = Groups::Indirect { buffer: ARGS, offset: 24 };
            plan.passes[2].work = Work::Dispatch { shader: ShaderId(0), groups };
        }),
        ("at byte 18446744073709551612", |plan| plan.stats[0].offset = u64::MAX - 3),
        ("uses `splats` as", |plan| plan.passes[0].work = Work::Fill { buffer: SPLATS, value: 0 }),
        ("frame ends with the export", |plan| _ = plan.frame.pop()),
        ("frame ends with the export", |plan| _ = plan.frame.remove(3)),
        ("frame ends with the export", |plan| plan.frame.rotate_left(1)),
        ("frame ends with the export", |plan| plan.passes[1].work = Work::Host),
        ("zeroes a resource's history", |plan| plan.passes[1].work = Work::ClearHistory { resource: WORDS }),
        ("uses `color` as", |plan| plan.passes[0].work = Work::ClearHistory { resource: COLOR }),
        ("1 statistics, and 0 resources of 0 bytes", |plan| {
            plan.resources[READBACK.index()].source = Source::Live;
        }),
        ("brings `words` into the layout General", |plan| {
            plan.layout_changes = vec![changed(WORDS, Layout::Undefined, Layout::General)];
        }),
        ("layout Undefined", |plan| {
            plan.layout_changes = vec![changed(COLOR, Layout::General, Layout::Undefined)];
        }),
        ("alias `args` that does not belong to it", |plan| plan.blocks[0].aliases.push(ARGS)),
        ("`words` is in no block", |plan| plan.blocks[0].aliases.clear()),
        ("pass 9", |plan| plan.dependencies = vec![needs(PassId(9), PassId(1), WORDS, None)]),
        ("pass 9", |plan| plan.dependencies = vec![needs(PassId(0), PassId(9), WORDS, None)]),
        ("resource 77", |plan| plan.dependencies = vec![needs(PassId(0), PassId(1), ResourceId(77), None)]),
        ("resource 77", |plan| {
            plan.dependencies = vec![needs(PassId(0), PassId(1), WORDS, Some(ResourceId(77)))];
        }),
        ("not sorted by their later pass", |plan| {
            plan.dependencies = [2, 1].map(|second| needs(PassId(0), PassId(second), WORDS, None)).to_vec();
        }),
    ];
    for (expected, alter) in alterations {
        let text = said(|plan, _| alter(plan));
        assert!(text.contains(expected), "expected `{expected}` in `{text}`");
    }
}

#[test]
fn a_buffer_that_comes_with_a_frame_is_storage_that_frames_read() {
    let with = |alter: fn(&mut Plan)| {
        said(|plan, _| {
            plan.resources[SPLATS.index()].source = Source::HostBuffer { buffer: "frame.words".to_string() };
            alter(plan);
        })
    };
    assert_eq!(with(|_| {}), "");
    let read = with(|plan| {
        plan.resources[SPLATS.index()].usage |= Usage::INDIRECT;
        let groups = Groups::Indirect { buffer: SPLATS, offset: 0 };
        plan.passes[2].work = Work::Dispatch { shader: ShaderId(0), groups };
    });
    assert_eq!(read, "");
    // Only the words within the minimum size can be used.
    let beyond = with(|plan| {
        plan.resources[SPLATS.index()].usage |= Usage::INDIRECT;
        let offset = plan.resources[SPLATS.index()].bytes() - 8;
        let groups = Groups::Indirect { buffer: SPLATS, offset };
        plan.passes[2].work = Work::Dispatch { shader: ShaderId(0), groups };
    });
    assert!(beyond.contains("uses 12 bytes at byte"), "{beyond}");
    let uniform = with(|plan| {
        let binding = plan.passes[3].bindings.iter_mut().find(|b| b.resource == SPLATS);
        binding.expect("it is bound").kind = DescriptorKind::UniformBuffer;
    });
    assert!(uniform.contains("pass `splat` binds `splats`, a storage buffer"), "{uniform}");
    let filled = with(|plan| {
        plan.resources[SPLATS.index()].usage |= Usage::COPY_TARGET;
        plan.passes[0].work = Work::Fill { buffer: SPLATS, value: 0 };
    });
    assert!(filled.contains("pass `clear` writes to `splats`"), "{filled}");
    for (accesses, refused) in [(Accesses::STORAGE_READ, false), (Accesses::STORAGE_WRITE, true)] {
        let text = said(|plan, _| {
            plan.resources[SPLATS.index()].source = Source::HostBuffer { buffer: "frame.words".to_string() };
            plan.passes[3].uses.push(touch(SPLATS, accesses));
        });
        assert_eq!(text.contains("pass `splat` writes to `splats`"), refused, "{text}");
    }
}

#[test]
fn a_buffer_that_comes_with_a_frame_counts_among_a_passs_descriptors_and_sizes() {
    let with = |alter: fn(&mut Plan, &mut Limits)| {
        said(|plan, limits| {
            plan.resources[SPLATS.index()].source = Source::HostBuffer { buffer: "frame.words".to_string() };
            alter(plan, limits);
        })
    };
    let many = with(|_, limits| limits.max_storage_buffers = 1);
    assert!(many.contains("storage buffers bound by pass `splat`"), "{many}");
    let large = with(|plan, _| buffer(plan, SPLATS, 40_000_000));
    assert!(large.contains("`splats`, bound as a storage buffer by pass `splat`"), "{large}");
}

#[test]
fn a_plane_imported_twice_counts_once_and_one_that_only_the_prologue_uses_does_not_count() {
    let size = 37_156;
    let twice = |plan: &mut Plan| plan.resources.push(plan.resources[SPLATS.index()].clone());
    let with = |heap_bytes: u64, alter: &dyn Fn(&mut Plan)| {
        said(|plan, limits| {
            limits.heap_bytes = heap_bytes;
            alter(plan);
        })
    };
    assert_eq!(with(size, &twice), "");
    assert!(with(size - 1, &twice).contains("found 37156 bytes"), "{}", with(size - 1, &twice));
    let packed = |plan: &mut Plan| {
        twice(plan);
        plan.passes[3].bindings.retain(|binding| binding.resource != SPLATS);
        for plane in [SPLATS, ResourceId(plan.resources.len() as u32 - 1)] {
            plan.passes[0].uses.push(touch(plane, Accesses::STORAGE_READ));
        }
    };
    let needed = size - 16_384;
    assert_eq!(with(needed, &packed), "");
    let text = with(needed - 1, &packed);
    assert!(
        text.contains("the largest is `color` with 16384 bytes; a smaller picture needs less")
            && text.contains("found 20772"),
        "{text}"
    );
}

#[test]
fn what_shares_memory_counts_once() {
    // `words` and `args` have 4096 bytes each.
    let apart = |plan: &mut Plan, limits: &mut Limits| {
        buffer(plan, ARGS, 1024);
        limits.heap_bytes = 41_000;
    };
    let text = said(apart);
    assert!(text.contains("found 41220 bytes"), "{text}");
    let together = |plan: &mut Plan, limits: &mut Limits| {
        apart(plan, limits);
        plan.blocks[0].aliases.push(ARGS);
        plan.blocks[1].aliases.clear();
        plan.resources[ARGS.index()].block = Some(BlockId(0));
    };
    assert_eq!(said(together), "");
}
