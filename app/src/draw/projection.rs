//! Finds the projection that a graph draws, and converts cameras to it.
//!
//! A graph's projection is its constant parameter `projection`, because shaders are compiled for it. A camera has a
//! projection as well: files store it, and the exact renderer draws it. Pinhole cameras are converted to the graph's
//! projection; any other camera needs a graph with the same projection, except in a window (see [`shown`]). Cameras
//! with several projections are refused, even if some are pinholes: in a rig, each camera has its own lens.

use crate::draw::facts;
use crate::draw::planner::Planner;
use crate::io::output::one_line;
use splatgraph_assets::{Camera, Projection, Scene};
use splatgraph_framework::ir::{Param, Value};
use splatgraph_framework::lower::Control;

const PARAMETER: &str = "projection";

/// Error about a camera that the graph cannot draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a graph for {camera} cameras, found one for {graph} cameras{}", advice(*.camera))]
pub struct ProjectionError {
    /// Projection of the graph.
    pub graph: Projection,
    /// Projection of the camera.
    pub camera: Projection,
}

/// Cameras with several projections: each projection, the name of its first camera, and the number of its cameras.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected cameras with one projection, found {}; in --cameras, `FILE#NAME*` selects the cameras whose names begin with NAME",
    groups(.0)
)]
pub struct MixedProjections(Vec<(Projection, String, usize)>);

fn groups(groups: &[(Projection, String, usize)]) -> String {
    let text = |(projection, name, count): &(Projection, String, usize)| match count - 1 {
        0 => format!("{} ({projection})", one_line(name)),
        more => format!("{} and {more} more ({projection})", one_line(name)),
    };
    groups.iter().map(text).collect::<Vec<_>>().join(", ")
}

/// Error about cameras that a graph cannot draw.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConversionError {
    /// The cameras have several projections.
    #[error(transparent)]
    Mixed(#[from] MixedProjections),
    /// The graph has another projection.
    #[error(transparent)]
    Graph(#[from] ProjectionError),
}

fn advice(camera: Projection) -> String {
    if camera.is_pinhole() { String::new() } else { format!(": use --pipeline {camera}") }
}

/// Returns the projection among a graph's parameters. It is pinhole without such a parameter, or if the value is not
/// the name of a projection.
pub fn of_params<'a>(params: impl IntoIterator<Item = &'a Param>) -> Projection {
    let value = params.into_iter().find(|param| param.name == PARAMETER).map(|param| &param.value);
    match value {
        Some(Value::Text(name)) => name.parse().unwrap_or_default(),
        _ => Projection::Pinhole,
    }
}

/// Returns the projection among a graph's controls; see [`of_params`].
pub fn of_controls(controls: &[Control]) -> Projection {
    of_params(controls.iter().map(|control| &control.param))
}

/// Returns the projection of a graph with the parameters in `set`, before a scene is loaded. `None` for a graph with
/// errors; building its plan reports them.
///
/// `pipeline` is a preset's name or a path. The device is [`facts::portable_device`]: a choice on a real device may
/// draw another graph, but all graphs of a built-in choice have the same projection.
pub fn of_graph(pipeline: &str, set: &[(String, String)]) -> Option<Projection> {
    let facts = facts::nominal(facts::USUAL_SUBGROUP_SIZE);
    let controls = Planner::default().controls(pipeline, set, &facts, &facts::nominal_catalog());
    Some(of_controls(&controls.ok()?))
}

/// Returns the projection in which a graph draws cameras; see [`of_graph`]. For a graph with errors, it is
/// [that of the cameras](of_cameras), so that the graph's errors are reported instead of its projection.
pub fn of_graph_for(pipeline: &str, set: &[(String, String)], cameras: &[Camera]) -> Projection {
    of_graph(pipeline, set).unwrap_or_else(|| of_cameras(cameras))
}

/// Returns the projection of a graph that suits cameras.
///
/// It is that of the first camera that is not a pinhole, or else pinhole.
pub fn of_cameras(cameras: &[Camera]) -> Projection {
    cameras.iter().map(|camera| camera.projection).find(|own| !own.is_pinhole()).unwrap_or_default()
}

/// Returns the projection that all cameras have; pinhole without cameras.
///
/// # Errors
/// Two cameras have different projections. Cameras without a name are named by their index.
pub fn shared(cameras: &[Camera]) -> Result<Projection, MixedProjections> {
    let mut groups: Vec<(Projection, String, usize)> = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        match groups.iter_mut().find(|(projection, ..)| *projection == camera.projection) {
            Some((.., count)) => *count += 1,
            None => {
                let name = &camera.img_name;
                let name = if name.is_empty() { format!("camera {index}") } else { name.clone() };
                groups.push((camera.projection, name, 1));
            }
        }
    }
    match groups[..] {
        [] => Ok(Projection::Pinhole),
        [(projection, ..)] => Ok(projection),
        _ => Err(MixedProjections(groups)),
    }
}

/// Checks that a graph can draw cameras of a projection, before a scene is loaded; see [`convert`].
///
/// # Errors
/// The cameras are not pinhole cameras, and their projection differs from the graph's.
pub fn check(camera: Projection, graph: Projection) -> Result<(), ProjectionError> {
    match camera.is_pinhole() || camera == graph {
        true => Ok(()),
        false => Err(ProjectionError { graph, camera }),
    }
}

/// Converts a camera to a graph's projection.
///
/// # Errors
/// The camera is not a pinhole camera, and its projection differs from the graph's.
pub fn convert(camera: &Camera, graph: Projection, scene: &Scene) -> Result<Camera, ProjectionError> {
    check(camera.projection, graph)?;
    Ok(camera.projected(graph, scene))
}

/// Converts a camera of any projection to the graph's projection, for a window, which must show every camera.
///
/// `scene` is the scene as loaded, so that hiding splats does not change the scale of an orthographic view.
pub fn shown(camera: &Camera, graph: Projection, scene: &Scene) -> Camera {
    match camera.projection == graph {
        true => camera.clone(),
        false => camera.with_projection(graph, scene.robust_bounds().center()),
    }
}

/// Converts a command's cameras to the projection of its graph. Without a requested `size`, they are [`shaped`] first.
///
/// # Errors
/// The cameras have several projections, or one that is not pinhole and differs from the graph's.
pub fn convert_all(
    cameras: &[Camera],
    graph: Projection,
    scene: &Scene,
    size: Option<(u32, u32)>,
) -> Result<Vec<Camera>, ConversionError> {
    shared(cameras)?;
    let converted = |camera: &Camera| match size {
        Some(_) => convert(camera, graph, scene),
        None => convert(&shaped(camera, graph), graph, scene),
    };
    Ok(cameras.iter().map(converted).collect::<Result<_, _>>()?)
}

/// Resizes a pinhole camera to 2:1 if it becomes a panorama: players expect that shape.
///
/// Returns other cameras unchanged.
pub fn shaped(camera: &Camera, graph: Projection) -> Camera {
    match (camera.projection, graph) {
        (Projection::Pinhole, Projection::Equirectangular) => {
            let (width, height) = default_size(graph, (camera.width, camera.height));
            camera.resized(width, height)
        }
        _ => camera.clone(),
    }
}

/// Returns the size of a picture for which none is requested, from that of a pinhole: 2:1 for a panorama.
pub fn default_size(projection: Projection, (width, height): (u32, u32)) -> (u32, u32) {
    match projection {
        Projection::Equirectangular => {
            let height = (width / 2).max(1);
            (2 * height, height)
        }
        _ => (width, height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;
    use splatgraph_assets::synth;

    #[test]
    fn each_projection_is_the_preset_of_its_name() {
        let of = |name: &str, set: &[(&str, &str)]| of_graph(name, &testing::set(set));
        for projection in Projection::ALL.into_iter().filter(|projection| !projection.is_pinhole()) {
            assert_eq!(of(projection.name(), &[]), Some(projection));
            assert_eq!(of("tiled", &[("projection", projection.name())]), Some(projection));
        }
        assert_eq!(of("auto", &[]), Some(Projection::Pinhole));
        assert_eq!(of("splat", &[("projection", "fisheye")]), Some(Projection::Fisheye));
        let broken = [("projection", "equirectangular")];
        assert_eq!(of("splat", &broken), None, "a plan reports the error");
        let pinhole = Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (40, 30));
        let panorama = Camera { projection: Projection::Equirectangular, ..pinhole.clone() };
        let drawn =
            |set: &[_]| of_graph_for("splat", &testing::set(set), &[pinhole.clone(), panorama.clone()]);
        assert_eq!([drawn(&broken), drawn(&[])], [panorama.projection, pinhole.projection]);
    }

    #[test]
    fn a_pinhole_camera_is_converted_and_another_one_needs_its_graph() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let camera = Camera::framing(&scene, 40, 30);
        let fisheye = convert(&camera, Projection::Fisheye, &scene).unwrap();
        assert_eq!(convert(&fisheye, Projection::Fisheye, &scene), Ok(fisheye.clone()));
        let error = convert(&fisheye, Projection::Pinhole, &scene).unwrap_err().to_string();
        assert_eq!(
            error,
            "expected a graph for fisheye cameras, found one for pinhole cameras: use --pipeline fisheye"
        );
    }

    #[test]
    fn a_pinhole_becomes_a_panorama_of_2_to_1_unless_a_size_is_requested() {
        let scene = synth::generate("uniform", 50, 0).unwrap();
        let camera = Camera::framing(&scene, 979, 546);
        let sizes = |graph, size| {
            let found = convert_all(std::slice::from_ref(&camera), graph, &scene, size).unwrap();
            (found[0].projection, found[0].width, found[0].height)
        };
        let panorama = Projection::Equirectangular;
        assert_eq!(sizes(panorama, None), (panorama, 978, 489));
        assert_eq!(sizes(panorama, Some((979, 546))), (panorama, 979, 546));
        assert_eq!(sizes(Projection::Fisheye, None), (Projection::Fisheye, 979, 546));
        let file = Camera { projection: panorama, ..camera.clone() };
        assert_eq!(shaped(&file, panorama), file, "a panorama of a file keeps its size");
    }

    #[test]
    fn cameras_share_a_projection_or_two_that_differ_are_named() {
        let camera = |name: &str, projection| Camera {
            img_name: name.into(),
            projection,
            ..Camera::looking_at([0.0; 3], [0.0, 0.0, 1.0], 60.0, (40, 30))
        };
        let [left, right] = ["left.png", ""].map(|name| camera(name, Projection::Fisheye));
        assert_eq!(shared(&[]), Ok(Projection::Pinhole));
        assert_eq!(shared(&[left.clone(), right.clone()]), Ok(Projection::Fisheye));
        let mixed = [left, right, camera("", Projection::Pinhole)];
        let error = shared(&mixed).unwrap_err().to_string();
        assert_eq!(
            error,
            "expected cameras with one projection, found left.png and 1 more (fisheye), camera 2 (pinhole); in --cameras, `FILE#NAME*` selects the cameras whose names begin with NAME"
        );
        let scene = synth::generate("uniform", 50, 0).unwrap();
        for graph in [Projection::Fisheye, Projection::Pinhole] {
            assert_eq!(convert_all(&mixed, graph, &scene, None).unwrap_err().to_string(), error);
        }
    }
}
