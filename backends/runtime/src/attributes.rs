//! Shares the planes of the scene's attributes among all plans of a device.
//!
//! A plane is not written after its upload. The [`AttributeCache`] finds the planes that some plan still holds; a plane
//! enters it when its upload is complete, unless it is in host memory. Only one plan uploads at a time. Another plan
//! that lacks a plane waits for that upload, then searches the cache again.

use crate::lock::lock;
use splatgraph_framework::ir::{ResourceId, Shape, Source};
use splatgraph_framework::plan::{Plan, Resource};
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, Weak};

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PlaneKey {
    /// Identity of the scene; see [`splatgraph_api::SceneData::identity`].
    pub identity: u64,
    pub attribute: String,
    pub plane: u32,
    /// Bytes per entry.
    pub stride: u64,
    pub bytes: u64,
}

/// Planes on the device, or created by a plan that is about to upload them.
pub(crate) type Planes<B> = HashMap<PlaneKey, Arc<B>>;

pub(crate) fn keys(plan: &Plan, identity: u64, unused: &BTreeSet<ResourceId>) -> Vec<(ResourceId, PlaneKey)> {
    let ids = (0..plan.resources.len() as u32).map(ResourceId).filter(|id| !unused.contains(id));
    ids.filter_map(|id| Some((id, key(plan.resource(id), identity)?))).collect()
}

/// Returns the key of a resource; `None` unless it is a plane of the scene.
pub(crate) fn key(resource: &Resource, identity: u64) -> Option<PlaneKey> {
    let (Source::Scene { attribute, plane }, Shape::Buffer { stride, .. }) =
        (&resource.source, resource.shape)
    else {
        return None;
    };
    Some(PlaneKey { identity, attribute: attribute.clone(), plane: *plane, stride, bytes: resource.bytes() })
}

/// The uploaded planes of a device. `B` is the buffer type.
pub(crate) struct AttributeCache<B> {
    complete: Mutex<HashMap<PlaneKey, Weak<B>>>,
    uploading: Mutex<()>,
}

impl<B> Default for AttributeCache<B> {
    fn default() -> Self {
        AttributeCache { complete: Mutex::default(), uploading: Mutex::default() }
    }
}

/// The exclusive right to upload.
pub(crate) type UploadGuard<'a> = MutexGuard<'a, ()>;

impl<B> AttributeCache<B> {
    /// Finds the planes of `keys` that are on the device. If any is missing, waits for the right to upload and returns
    /// it. Looks again after the wait: another plan may have uploaded the planes meanwhile.
    pub fn find(&self, keys: &[(ResourceId, PlaneKey)]) -> (Planes<B>, Option<UploadGuard<'_>>) {
        let held = self.lookup(keys);
        if keys.iter().all(|(_, key)| held.contains_key(key)) {
            return (held, None);
        }
        // A plan that failed or panicked has added nothing to the cache, so a poisoned lock is harmless.
        let turn = lock(&self.uploading);
        (self.lookup(keys), Some(turn))
    }

    /// Adds planes whose upload is complete, and forgets those that nothing holds any more.
    pub fn add<'a>(&self, planes: impl IntoIterator<Item = (&'a PlaneKey, &'a Arc<B>)>)
    where
        B: 'a,
    {
        let mut complete = lock(&self.complete);
        complete.retain(|_, plane| plane.strong_count() > 0);
        complete.extend(planes.into_iter().map(|(key, plane)| (key.clone(), Arc::downgrade(plane))));
    }

    fn lookup(&self, keys: &[(ResourceId, PlaneKey)]) -> Planes<B> {
        let complete = lock(&self.complete);
        keys.iter().filter_map(|(_, key)| Some((key.clone(), complete.get(key)?.upgrade()?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(plane: u32) -> (ResourceId, PlaneKey) {
        let attribute = "scene.sh".to_string();
        (ResourceId(plane), PlaneKey { identity: 1, attribute, plane, stride: 4, bytes: 4 })
    }

    #[test]
    fn a_plane_is_found_as_long_as_some_plan_has_it() {
        let cache = AttributeCache::<&str>::default();
        let plane = Arc::new("plane");
        cache.add([(&key(0).1, &plane)]);
        let (found, turn) = cache.find(&[key(0)]);
        assert!(turn.is_none() && Arc::ptr_eq(&found[&key(0).1], &plane));
        drop(plane);
        assert!(cache.find(&[key(0)]).1.is_none());
        drop(found);
        let (found, turn) = cache.find(&[key(0)]);
        assert!(found.is_empty() && turn.is_some());
    }

    #[test]
    fn a_plan_that_lacks_a_plane_waits_for_the_one_that_uploads_it() {
        let cache = AttributeCache::<&str>::default();
        let (_, turn) = cache.find(&[key(0)]);
        let plane = Arc::new("plane");
        std::thread::scope(|scope| {
            let second = scope.spawn(|| cache.find(&[key(0)]).0);
            assert!(cache.find(&[]).1.is_none());
            cache.add([(&key(0).1, &plane)]);
            drop(turn);
            assert!(Arc::ptr_eq(&second.join().expect("it ends well")[&key(0).1], &plane));
        });
    }

    #[test]
    fn only_scene_attributes_are_planes() {
        let plan = crate::testing::plan();
        let keys = keys(&plan, 7, &BTreeSet::new());
        assert_eq!(keys.len(), 1);
        assert_eq!((keys[0].1.identity, keys[0].1.attribute.as_str()), (7, "scene.sh"));
    }
}
