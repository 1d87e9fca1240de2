//! Finds the splats of a pixel on another thread. The newest request wins.
//!
//! A request cancels the previous one, so that the search can follow the pointer. [`crate::draw::pick`] defines the
//! result.

use super::renderer::Wake;
use crate::draw::pick::{Picked, pick};
use splatgraph_assets::{Camera, Scene};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// A search in progress. Dropping it cancels the search.
struct Request {
    found: Receiver<Picked>,
    cancelled: Arc<AtomicBool>,
}

impl Drop for Request {
    fn drop(&mut self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }
}

/// The search for the splats of a pixel, and its last result.
pub struct Picker {
    request: Option<Request>,
    wake: Wake,
}

impl Picker {
    /// Creates a picker that calls `wake` when splats have been found.
    pub fn new(wake: Wake) -> Picker {
        Picker { request: None, wake }
    }

    /// Starts a search for the splats of a pixel, and cancels the previous one.
    ///
    /// `camera` is in the scene's coordinates, with the size of the picture.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn start(&mut self, scene: Arc<Scene>, camera: Camera, pixel: [u32; 2]) -> Result<(), String> {
        self.cancel();
        let (done, found) = channel();
        let request = Request { found, cancelled: Arc::default() };
        let (cancelled, wake) = (request.cancelled.clone(), self.wake.clone());
        let work = move || {
            let picked = pick(&scene, &camera, pixel, &|| cancelled.load(Ordering::Relaxed));
            // Nobody receives the result of a search that was cancelled at the last moment.
            if picked.is_some_and(|picked| done.send(picked).is_ok()) {
                wake();
            }
        };
        let thread = std::thread::Builder::new().name("pick".to_owned()).spawn(work);
        thread.map_err(|error| format!("no thread can be started to find splats: {error}"))?;
        self.request = Some(request);
        Ok(())
    }

    /// Cancels the search.
    pub fn cancel(&mut self) {
        self.request = None;
    }

    /// Returns true during a search.
    pub fn busy(&self) -> bool {
        self.request.is_some()
    }

    /// Takes the splats of the newest request, once they are found.
    pub fn take(&mut self) -> Option<Picked> {
        let found = self.request.as_ref()?.found.try_recv();
        if !matches!(found, Err(TryRecvError::Empty)) {
            self.request = None;
        }
        found.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use splatgraph_assets::synth;
    use std::sync::mpsc::Sender;
    use std::time::Duration;

    fn picker() -> (Picker, Receiver<()>) {
        let (woken, wakes): (Sender<()>, _) = channel();
        (Picker::new(Arc::new(move || woken.send(()).unwrap_or(()))), wakes)
    }

    #[test]
    fn found_splats_wake_the_window_and_are_taken_once() {
        let scene = Arc::new(synth::generate("uniform", 500, 0).unwrap());
        let camera = Camera::framing(&scene, 64, 48);
        let (mut picker, wakes) = picker();
        assert_eq!((picker.busy(), picker.take()), (false, None));
        picker.start(scene.clone(), camera.clone(), [32, 24]).unwrap();
        assert!(picker.busy());
        wakes.recv_timeout(Duration::from_secs(60)).expect("a call of wake");
        let picked = picker.take().expect("splats");
        assert_eq!((&picked.camera, picked.pixel), (&camera, [32, 24]));
        assert_eq!(Some(picked), pick(&scene, &camera, [32, 24], &|| false));
        assert_eq!((picker.busy(), picker.take()), (false, None));
    }

    #[test]
    fn of_many_requests_only_the_newest_is_answered() {
        let scene = Arc::new(synth::generate("uniform", 200_000, 0).unwrap());
        let camera = Camera::framing(&scene, 64, 48);
        let (mut picker, wakes) = picker();
        for x in 0..30 {
            picker.start(scene.clone(), camera.clone(), [x, 24]).unwrap();
        }
        let picked = loop {
            wakes.recv_timeout(Duration::from_secs(60)).expect("a call of wake");
            if let Some(picked) = picker.take() {
                break picked;
            }
        };
        assert_eq!(picked.pixel, [29, 24]);
        picker.start(scene, camera, [0, 24]).unwrap();
        picker.cancel();
        assert_eq!((picker.busy(), picker.take()), (false, None));
    }

    #[test]
    fn a_search_outside_of_the_picture_ends_without_splats() {
        let scene = Arc::new(synth::generate("uniform", 50, 0).unwrap());
        let (mut picker, _wakes) = picker();
        picker.start(scene.clone(), Camera::framing(&scene, 64, 48), [64, 0]).unwrap();
        while picker.busy() {
            assert_eq!(picker.take(), None);
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
