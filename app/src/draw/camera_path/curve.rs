//! Interpolates the keys of a camera path, and measures the curve's length.
//!
//! A key is a point with four components: position, rotation, zoom and principal point. Each is interpolated by cubic
//! segments whose slopes are those of a Catmull-Rom spline with centripetal knots: the knot interval of a segment is
//! the square root of the distance between its keys (Yuksel et al., On the Parameterization of Catmull-Rom Curves,
//! 2009). All components share the knots, so that they pass a key without a kink. Rotations are interpolated by squad
//! (Shoemake, Quaternion Calculus for Fast Animation, 1987), with inner quaternions that give it these slopes.
//!
//! A component that is equal at two adjacent keys stays constant between them. Slopes of a component that changes
//! little beside keys with large steps are limited, so that the camera does not spin; see [`STEEPEST`].
//!
//! Keys that are frames have knot intervals of 1 instead. The curve's length then counts frames, so that equal frames
//! are a hold.
//!
//! Between level keys, squad rolls the camera: by 11 degrees on a closed path through the demo scene's cameras. If all
//! keys are level, this roll is removed; see [`Segment::at`].

use glam::{DMat3, DQuat, DVec3};
use splatgraph_assets::{Camera, Projection};

/// Change below which a component counts as constant, in the unit of [`View::distance`].
const STILL: f64 = 1e-9;
/// Maximum slope: a multiple of the straight line's slope, plus a constant.
///
/// Slopes within the multiple, in the line's direction, do not overshoot (Fritsch and Carlson, Monotone Piecewise Cubic
/// Interpolation, 1980). The constant adds an overshoot of at most a quarter of itself.
const STEEPEST: (f64, f64) = (3.0, 1.0);
/// Maximum relative difference between the halves of an interval of the table, and between its length and its chord.
const UNEVEN: f64 = 1e-3;
/// Minimum and maximum depth of the bisection of a segment.
const BISECTIONS: (u32, u32) = (4, 24);
/// Length below which the minimum of bisections suffices, as a fraction of the summed distances between keys.
const TINY: f64 = 1e-7;
/// Length below which the minimum of bisections suffices, and keys count as equal, in rounding errors of a view.
const NOISE: f64 = 1e3;
/// Maximum sine of a level key's roll: that of 0.1 degrees.
const LEVEL: f64 = 1.75e-3;
/// Vertical component of the picture's upward direction from which a view is kept level: 11.5 degrees from a pole. A
/// level view nearer to the pole would spin.
const UPRIGHT: f64 = 0.2;

/// Position, rotation, zoom and principal point of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View {
    position: DVec3,
    /// Unit quaternion from the camera's axes to the world's.
    rotation: DQuat,
    /// Natural logarithms of the horizontal and the vertical focal length, relative to the picture's height; z is 0. An
    /// equirectangular view, which shows all directions, has zeros.
    zoom: DVec3,
    /// Offset of the principal point, relative to the picture's height; z is 0.
    principal_offset: DVec3,
}

impl View {
    pub(super) fn of(camera: &Camera) -> View {
        let height = f64::from(camera.height);
        View {
            position: camera.position.into(),
            rotation: DQuat::from_mat3(&DMat3::from_cols_array_2d(&camera.axes())).normalize(),
            zoom: match camera.projection {
                Projection::Equirectangular => DVec3::ZERO,
                _ => DVec3::new((camera.fx / height).ln(), (camera.fy / height).ln(), 0.0),
            },
            principal_offset: DVec3::new(
                camera.principal_offset[0] / height,
                camera.principal_offset[1] / height,
                0.0,
            ),
        }
    }

    /// Makes a camera with this view, the given projection, and the picture size of `sized`.
    pub(super) fn camera(&self, sized: &Camera, projection: Projection) -> Camera {
        let (width, height) = (sized.width, sized.height);
        let focal = |zoom: f64| zoom.exp() * f64::from(height);
        let camera = Camera {
            id: 0,
            img_name: String::new(),
            width,
            height,
            position: self.position.into(),
            rotation: DMat3::from_quat(self.rotation).transpose().to_cols_array_2d(),
            fx: focal(self.zoom.x),
            fy: focal(self.zoom.y),
            principal_offset: [self.principal_offset.x, self.principal_offset.y]
                .map(|v| v * f64::from(height)),
            projection,
        };
        camera.rounded()
    }

    /// Computes the distance between two views, in radians.
    ///
    /// A rotation counts as its angle. A translation by `radian` world units counts as 1, as does a change of the focal
    /// length by a factor of e, and an offset of the principal point by the picture's height. The distance is the
    /// Euclidean norm of these components.
    pub(super) fn distance(&self, to: &View, radian: f64) -> f64 {
        let way = (to.position - self.position).length() / radian;
        let between = self.rotation.inverse() * to.rotation;
        // A quaternion and its negative are the same rotation.
        let turn = 2.0 * log(if between.w < 0.0 { -between } else { between }).length();
        // Root mean square of the two zooms.
        let zoom = (to.zoom - self.zoom).length() * std::f64::consts::FRAC_1_SQRT_2;
        DVec3::new(way, turn, zoom.hypot((to.principal_offset - self.principal_offset).length())).length()
    }

    /// Computes the vertical components of the picture's right and upward direction. The first is 0 for a level view.
    fn tilt(&self, up: DVec3) -> (f64, f64) {
        ((self.rotation * DVec3::X).dot(up), -(self.rotation * DVec3::Y).dot(up))
    }

    /// Computes the rotation about the view's axis that makes it level, in radians; it fades to 0 near the poles.
    fn roll(&self, up: DVec3) -> f64 {
        let (right, upward) = self.tilt(up);
        let fade = (upward / UPRIGHT).clamp(0.0, 1.0);
        fade * fade * (3.0 - 2.0 * fade) * right.atan2(upward)
    }

    /// Estimates the rounding error of a view, in the unit of [`View::distance`].
    fn rounding(&self, radian: f64) -> f64 {
        f64::EPSILON
            * (self.position.length() / radian + self.zoom.length() + self.principal_offset.length() + 1.0)
    }
}

/// A curve between two keys, with a parameter from 0 to 1.
#[derive(Clone, Copy, Debug)]
struct Segment {
    from: View,
    /// Second key. The sign of its quaternion is chosen so that the rotation from the first key is at most 180 degrees.
    to: View,
    /// Slopes at both ends, with respect to the parameter, as of `zoom` and `principal_offset`.
    position: [DVec3; 2],
    zoom: [DVec3; 2],
    principal_offset: [DVec3; 2],
    /// Inner quaternions of squad.
    inner: [DQuat; 2],
    /// World's up direction if all keys are level, else 0.
    up: DVec3,
}

impl Segment {
    /// Computes the view at a parameter. If the keys are level, it is level, too, except near the poles.
    fn at(&self, u: f64) -> View {
        let Segment { from, to, inner, up, .. } = self;
        if from == to {
            return *from;
        }
        let outer = slerp(from.rotation, to.rotation, u);
        let inner = slerp(inner[0], inner[1], u);
        let view = View {
            position: hermite(from.position, to.position, self.position, u),
            rotation: slerp(outer, inner, 2.0 * u * (1.0 - u)).normalize(),
            zoom: hermite(from.zoom, to.zoom, self.zoom, u),
            principal_offset: hermite(from.principal_offset, to.principal_offset, self.principal_offset, u),
        };
        // The keys keep their small rolls, so that the path passes through them.
        let roll = view.roll(*up) - from.roll(*up) * (1.0 - u) - to.roll(*up) * u;
        View { rotation: view.rotation * DQuat::from_rotation_z(roll), ..view }
    }
}

/// A curve through views, with a table of its length.
#[derive(Clone, Debug, Default)]
pub(super) struct Curve {
    segments: Vec<Segment>,
    /// Ascending pairs: length from the start, and position there (segment index plus parameter).
    table: Vec<(f64, f64)>,
    /// Length from the start to each key.
    pub(super) keys: Vec<f64>,
}

impl Curve {
    /// Makes a curve through views; a closed curve returns to the first. `radian` is that of [`View::distance`], `up`
    /// the world's up direction, of length 1. If the views are `frames`, each segment has a length of 1.
    pub(super) fn new(views: &[View], closed: bool, frames: bool, radian: f64, up: DVec3) -> Curve {
        let is_level = |(right, upward): (f64, f64)| right.abs() < LEVEL && upward > -LEVEL;
        let up = if views.iter().all(|view| is_level(view.tilt(up))) { up } else { DVec3::ZERO };
        let noise = NOISE * views.iter().map(|view| view.rounding(radian)).fold(0.0, f64::max);
        // Consecutive equal keys share one knot, unless they are frames.
        let (mut knots, mut knot_of): (Vec<View>, Vec<usize>) = (Vec::new(), Vec::new());
        for view in views {
            if frames || knots.last().is_none_or(|last| last.distance(view, radian) > noise) {
                knots.push(*view);
            }
            knot_of.push(knots.len() - 1);
        }
        let mut pairs: Vec<(View, View)> = knots.windows(2).map(|pair| (pair[0], pair[1])).collect();
        if let (true, [first, .., last]) = (closed, knots.as_slice())
            && (frames || last.distance(first, radian) > noise)
        {
            pairs.push((*last, *first));
        }
        for (from, to) in &mut pairs {
            if from.rotation.dot(to.rotation) < 0.0 {
                to.rotation = -to.rotation;
            }
        }
        let distances: Vec<f64> = pairs.iter().map(|(from, to)| from.distance(to, radian)).collect();
        let interval = |distance: &f64| if frames { 1.0 } else { distance.sqrt() };
        let intervals: Vec<f64> = distances.iter().map(interval).collect();
        let slopes = |step: &dyn Fn(&(View, View)) -> DVec3, unit: f64| {
            slopes(&pairs.iter().map(step).collect::<Vec<_>>(), &distances, &intervals, closed, unit)
        };
        let position = slopes(&|(from, to)| to.position - from.position, radian);
        let zoom = slopes(&|(from, to)| to.zoom - from.zoom, 1.0);
        let principal_offset = slopes(&|(from, to)| to.principal_offset - from.principal_offset, 1.0);
        // The logarithm of a unit quaternion is half the rotation vector, so its unit is half a radian.
        let turns = slopes(&|(from, to)| log(from.rotation.inverse() * to.rotation), 0.5);
        let segment = |(at, (from, to)): (usize, &(View, View))| {
            let step = log(from.rotation.inverse() * to.rotation);
            let [start, end] = turns[at];
            let turned = |rotation: DQuat, turn: DVec3| rotation * DQuat::from_scaled_axis(turn);
            let inner = [turned(from.rotation, start - step), turned(to.rotation, step - end)];
            Segment {
                from: *from,
                to: *to,
                position: position[at],
                zoom: zoom[at],
                principal_offset: principal_offset[at],
                inner,
                up,
            }
        };
        let segments = pairs.iter().enumerate().map(segment).collect();
        let mut curve = Curve { segments, table: vec![(0.0, 0.0)], keys: Vec::new() };
        let tiny = (TINY * distances.iter().sum::<f64>()).max(noise);
        let mut lengths = vec![0.0];
        for at in 0..curve.segments.len() {
            if frames {
                curve.table.push(((at + 1) as f64, (at + 1) as f64));
            } else {
                let segment = curve.segments[at];
                let ends = [(0.0, segment.at(0.0)), (1.0, segment.at(1.0))];
                curve.measure(at, ends, radian, tiny, 0);
            }
            lengths.push(curve.length());
        }
        curve.keys = knot_of.iter().map(|knot| lengths[*knot]).collect();
        curve
    }

    /// Adds part of a segment to the table, bisected until its length grows nearly in proportion to the parameter.
    fn measure(&mut self, at: usize, ends: [(f64, View); 2], radian: f64, tiny: f64, bisections: u32) {
        let [(start, from), (end, to)] = ends;
        let middle = 0.5 * (start + end);
        let view = self.segments[at].at(middle);
        let halves = [from.distance(&view, radian), view.distance(&to, radian)];
        let length = halves[0] + halves[1];
        let uneven = (halves[0] - halves[1]).abs() > UNEVEN * length;
        let bent = length - from.distance(&to, radian) > UNEVEN * length;
        let coarse = bisections < BISECTIONS.0 || length > tiny && (uneven || bent);
        if !coarse || bisections == BISECTIONS.1 {
            for (half, place) in halves.into_iter().zip([middle, end]) {
                self.table.push((self.length() + half, at as f64 + place));
            }
        } else {
            self.measure(at, [(start, from), (middle, view)], radian, tiny, bisections + 1);
            self.measure(at, [(middle, view), (end, to)], radian, tiny, bisections + 1);
        }
    }

    /// Returns the length of the curve, in the unit of [`View::distance`].
    pub(super) fn length(&self) -> f64 {
        self.table.last().map_or(0.0, |(length, _)| *length)
    }

    /// Computes the view at a length from the start; `None` for a curve of length 0.
    pub(super) fn at(&self, length: f64) -> Option<View> {
        let beyond =
            self.table.partition_point(|(start, _)| *start <= length).min(self.table.len().saturating_sub(1));
        let (to, from) = (self.table.get(beyond)?, self.table.get(beyond.checked_sub(1)?)?);
        let part = (length - from.0) / (to.0 - from.0);
        let place = from.1 + (to.1 - from.1) * if part.is_finite() { part.clamp(0.0, 1.0) } else { 1.0 };
        let segment = (place as usize).min(self.segments.len().checked_sub(1)?);
        (self.length() > 0.0).then(|| self.segments[segment].at(place - segment as f64))
    }
}

/// Computes the slopes of a component at both ends of each segment, with respect to the segment's parameter.
///
/// `steps` are the component's differences along the segments. `distances` are the distances between the keys, and
/// `intervals` those of the knots, which are not 0. `unit` is the step of this component that counts as a distance
/// of 1. At an end without a neighbour, and for a constant component, the slope is the step.
fn slopes(steps: &[DVec3], distances: &[f64], intervals: &[f64], closed: bool, unit: f64) -> Vec<[DVec3; 2]> {
    let count = steps.len();
    let beside = |at: usize, other: Option<usize>| {
        let (Some(other), false) = (other, steps[at].length() <= STILL * unit) else { return steps[at] };
        let (here, there) = (intervals[at], intervals[other]);
        let slope = here * (steps[at] / here * there + steps[other] / there * here) / (here + there);
        let (share, free) = STEEPEST;
        slope.clamp_length_max(share * steps[at].length() + free * unit * distances[at].min(1.0))
    };
    let ends = |at: usize| {
        let before = at.checked_sub(1).or(closed.then_some(count - 1));
        let after = Some(at + 1).filter(|after| *after < count).or(closed.then_some(0));
        [beside(at, before), beside(at, after)]
    };
    (0..count).map(ends).collect()
}

fn hermite(from: DVec3, to: DVec3, [start, end]: [DVec3; 2], u: f64) -> DVec3 {
    let (square, cube) = (u * u, u * u * u);
    from * (2.0 * cube - 3.0 * square + 1.0)
        + to * (3.0 * square - 2.0 * cube)
        + start * (cube - 2.0 * square + u)
        + end * (cube - square)
}

/// Computes the logarithm of a unit quaternion: half the angle along the axis, of length 0 to pi.
fn log(q: DQuat) -> DVec3 {
    let (vector, w) = (DVec3::new(q.x, q.y, q.z), q.w);
    let sine = vector.length();
    // The quaternion -1 has no axis, and rotates by nothing.
    if sine > 0.0 { vector / sine * sine.atan2(w) } else { DVec3::ZERO }
}

/// Interpolates along the great circle. Unlike the usual slerp, does not flip signs to take the shorter arc: squad
/// needs the arc that the signs give.
fn slerp(from: DQuat, to: DQuat, t: f64) -> DQuat {
    from * DQuat::from_scaled_axis(2.0 * t * log(from.inverse() * to))
}
