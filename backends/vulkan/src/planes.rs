//! Planes of the scene's attributes, which all plans of a device share.
//!
//! A plane is uploaded once and never written again, so that any number of plans can read it, of one executor or of several.
//! The device knows those that are alive ([`Shelf`]); each plan that reads a plane keeps it alive. A plane comes to the shelf
//! when its upload is complete, not before, and only one plan is uploading at a time: whoever lacks a plane waits for its turn
//! and looks again.

use crate::memory::Buffer;
use splatgraph_framework::ir::Source;
use splatgraph_framework::plan::Plan;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// What tells one plane of scene data from another.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PlaneKey {
    /// [`splatgraph_api::SceneData::identity`].
    pub identity: u64,
    pub attribute: String,
    pub plane: u32,
    pub bytes: u64,
}

/// Planes that are on the device, or that a plan is about to bring there.
pub(crate) type Planes = HashMap<PlaneKey, Arc<Buffer>>;

/// The planes that `plan` reads, of the scene with this identity.
pub(crate) fn keys(plan: &Plan, identity: u64) -> Vec<PlaneKey> {
    let key = |source: &Source, bytes| match source {
        Source::Scene { attribute, plane } => {
            Some(PlaneKey { identity, attribute: attribute.clone(), plane: *plane, bytes })
        }
        _ => None,
    };
    plan.resources.iter().filter_map(|resource| key(&resource.source, resource.bytes())).collect()
}

/// The complete planes of a device.
pub(crate) struct Shelf<B = Buffer> {
    complete: Mutex<HashMap<PlaneKey, Weak<B>>>,
    uploading: Mutex<()>,
}

impl<B> Default for Shelf<B> {
    fn default() -> Self {
        Shelf { complete: Mutex::default(), uploading: Mutex::default() }
    }
}

/// The right to upload, of one plan at a time.
pub(crate) type Turn<'a> = MutexGuard<'a, ()>;

impl<B> Shelf<B> {
    /// Those of `keys` that are there. If some are not, also the turn to bring them: the plan that had it before may have been
    /// bringing them, and has ended.
    pub fn find(&self, keys: &[PlaneKey]) -> (HashMap<PlaneKey, Arc<B>>, Option<Turn<'_>>) {
        let there = self.there(keys);
        if keys.iter().all(|key| there.contains_key(key)) {
            return (there, None);
        }
        // A plan that failed, or panicked, has added nothing.
        let turn = self.uploading.lock().unwrap_or_else(PoisonError::into_inner);
        (self.there(keys), Some(turn))
    }

    /// Planes that are complete now.
    pub fn add<'a>(&self, planes: impl IntoIterator<Item = (&'a PlaneKey, &'a Arc<B>)>)
    where
        B: 'a,
    {
        let mut complete = self.complete.lock().unwrap_or_else(PoisonError::into_inner);
        complete.retain(|_, plane| plane.strong_count() > 0);
        complete.extend(planes.into_iter().map(|(key, plane)| (key.clone(), Arc::downgrade(plane))));
    }

    fn there(&self, keys: &[PlaneKey]) -> HashMap<PlaneKey, Arc<B>> {
        let complete = self.complete.lock().unwrap_or_else(PoisonError::into_inner);
        keys.iter().filter_map(|key| Some((key.clone(), complete.get(key)?.upgrade()?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(plane: u32) -> PlaneKey {
        PlaneKey { identity: 1, attribute: "scene.sh".to_string(), plane, bytes: 4 }
    }

    #[test]
    fn a_plane_is_found_as_long_as_some_plan_has_it() {
        let shelf = Shelf::<&str>::default();
        let plane = Arc::new("plane");
        shelf.add([(&key(0), &plane)]);
        let (found, turn) = shelf.find(&[key(0)]);
        assert!(turn.is_none() && Arc::ptr_eq(&found[&key(0)], &plane));
        // Another plan has it, and then none.
        drop(plane);
        assert!(shelf.find(&[key(0)]).1.is_none());
        drop(found);
        let (found, turn) = shelf.find(&[key(0)]);
        assert!(found.is_empty() && turn.is_some());
    }

    #[test]
    fn who_lacks_a_plane_waits_for_the_one_that_is_bringing_it() {
        let shelf = Shelf::<&str>::default();
        let (_, turn) = shelf.find(&[key(0)]);
        let plane = Arc::new("plane");
        std::thread::scope(|scope| {
            let second = scope.spawn(|| shelf.find(&[key(0)]).0);
            // One that lacks nothing does not wait.
            assert!(shelf.find(&[]).1.is_none());
            shelf.add([(&key(0), &plane)]);
            drop(turn);
            assert!(Arc::ptr_eq(&second.join().expect("it ends well")[&key(0)], &plane));
        });
    }

    #[test]
    fn only_scene_attributes_are_planes() {
        let plan = crate::testing::plan();
        let keys = keys(&plan, 7);
        assert_eq!(keys.len(), 1);
        assert_eq!((keys[0].identity, keys[0].attribute.as_str()), (7, "scene.sh"));
    }
}
