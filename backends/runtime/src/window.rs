//! Presents frames in a window.
//!
//! A frame's output is blitted to an acquired image of the swapchain. The blit is submitted right after the frame,
//! which itself never waits for the window: its timestamps do not include such a wait.
//!
//! A swapchain becomes *stale* when the window is resized, vsync is switched, an acquired image could not be presented,
//! or the window system reports that the swapchain is out of date, suboptimal for the first time, or without a surface.
//! The next frame to be shown then creates a new one. A window without pixels shows nothing.

use crate::check::invalid;
use crate::gpu::{Acquired, Gpu, Image, Presented, Show, Swapchain as _};
use splatgraph_api::BackendError;
use splatgraph_framework::ir::Format;
use splatgraph_framework::plan::Plan;
use std::sync::Arc;
use std::time::Duration;

/// Maximum wait for the device before a swapchain is replaced.
const PATIENCE: Duration = Duration::from_secs(2);

/// The swapchain of a window, and the state that decides when to replace it.
pub(crate) struct Swapchain<G: Gpu> {
    // Dropped first, when the device is idle.
    raw: Option<G::Swapchain>,
    /// The window's size in pixels, as last reported by the caller.
    wanted_size: (u32, u32),
    vsync: bool,
    stale: bool,
    /// True if an image was acquired and not yet presented.
    acquired: bool,
    /// True once a rebuild after `SUBOPTIMAL` is due or done; a second `SUBOPTIMAL` is ignored.
    rebuilt_for_suboptimal: bool,
    /// True if the swapchain must be dropped and the surface recreated. False as soon as there is a new surface, even
    /// if the window has no pixels for a swapchain yet.
    surface_lost: bool,
    gpu: Arc<G>,
}

impl<G: Gpu> Swapchain<G> {
    /// Creates a swapchain for the device's window, or postpones this until the window has pixels. Refuses a window
    /// that cannot be drawn to.
    pub fn new(gpu: &Arc<G>, size: (u32, u32)) -> Result<Self, BackendError> {
        let mut swapchain = Swapchain {
            raw: None,
            wanted_size: size,
            vsync: true,
            stale: true,
            acquired: false,
            rebuilt_for_suboptimal: false,
            surface_lost: false,
            gpu: gpu.clone(),
        };
        swapchain.renew()?;
        Ok(swapchain)
    }

    pub fn resize(&mut self, size: (u32, u32)) {
        if size != self.wanted_size {
            (self.stale, self.rebuilt_for_suboptimal) = (true, false);
        }
        self.wanted_size = size;
    }

    pub fn set_vsync(&mut self, vsync: bool) {
        if vsync != self.vsync {
            (self.stale, self.rebuilt_for_suboptimal) = (true, false);
        }
        self.vsync = vsync;
    }

    /// Acquires an image of the window and records the blit of `output` into it. Returns the image's index; `None` if
    /// nothing can be shown now.
    ///
    /// The blit is submitted after the frame in `slot`; the image is then [`present`](Swapchain::present)ed. The slot's
    /// previous frame must have completed. Blocks as [`crate::Swapchain::acquire`] does.
    pub fn prepare(
        &mut self,
        output: &Image<G>,
        (plan, synchronization): (&Plan, &G::Synchronization),
        slot: usize,
    ) -> Result<Option<u32>, BackendError> {
        check_output(output.format, self.gpu.format_support(output.format).blit)?;
        let Some(image) = self.acquire(slot)? else { return Ok(None) };
        if let Some(raw) = &mut self.raw {
            raw.record_blit(image, slot, output, plan, synchronization)?;
        }
        Ok(Some(image))
    }

    pub fn show(&mut self, image: u32, slot: usize) -> Option<Show<'_, G>> {
        self.raw.as_mut().map(|swapchain| Show { swapchain, image, slot })
    }

    /// Presents an image, whose blit must have been submitted. Returns true if it is shown, and false if the swapchain
    /// or the surface must be replaced first.
    pub fn present(&mut self, image: u32) -> Result<bool, BackendError> {
        let Some(raw) = &mut self.raw else { return Ok(false) };
        let presented = raw.present(image);
        // Any other error leaves the image acquired, and only a new swapchain releases it.
        self.acquired = !matches!(presented, Ok(_) | Err(BackendError::SurfaceLost { .. }));
        match presented {
            Ok(Presented::Shown) => return Ok(true),
            Ok(Presented::Suboptimal) => {
                self.set_suboptimal();
                return Ok(true);
            }
            Ok(Presented::OutOfDate) => self.set_out_of_date(),
            // The frame is drawn but not shown. The next one gets a new surface.
            Err(BackendError::SurfaceLost { .. }) => self.lose_surface(),
            Err(error) => return Err(error),
        }
        Ok(false)
    }

    /// Marks the swapchain for a single rebuild: some window systems report `SUBOPTIMAL` for every swapchain.
    fn set_suboptimal(&mut self) {
        self.stale |= !self.rebuilt_for_suboptimal;
        self.rebuilt_for_suboptimal = true;
    }

    fn set_out_of_date(&mut self) {
        (self.stale, self.rebuilt_for_suboptimal) = (true, false);
    }

    fn lose_surface(&mut self) {
        self.set_out_of_date();
        self.surface_lost = true;
    }

    /// Replaces a stale swapchain, then acquires an image. `None` if that is impossible now: the window has no pixels,
    /// the device is busy, no image is ready, or two attempts failed.
    fn acquire(&mut self, slot: usize) -> Result<Option<u32>, BackendError> {
        // A submission or a presentation failed after its image was acquired, and only a new swapchain releases it.
        self.stale |= self.acquired;
        // The window may be resized between the two calls. After a second failure, the next frame tries again.
        for _ in 0..2 {
            let was_lost = self.surface_lost;
            match self.renew() {
                Ok(()) => {}
                // Retry with a new surface. If the new one is lost, too, the window is gone.
                Err(error @ BackendError::SurfaceLost { .. }) => {
                    self.lose_surface();
                    if was_lost {
                        return Err(error);
                    }
                    continue;
                }
                Err(error) => return Err(error),
            }
            let Some(swapchain) = self.raw.as_mut().filter(|_| !self.stale) else { return Ok(None) };
            match swapchain.acquire(slot) {
                Ok(Acquired::Image { index, suboptimal }) => {
                    self.acquired = true;
                    if suboptimal {
                        self.set_suboptimal();
                    }
                    return Ok(Some(index));
                }
                Ok(Acquired::OutOfDate) => self.set_out_of_date(),
                Ok(Acquired::NotReady) => return Ok(None),
                Err(BackendError::SurfaceLost { .. }) => self.lose_surface(),
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Replaces a stale swapchain, unless the window has no pixels or the device stays busy.
    fn renew(&mut self) -> Result<(), BackendError> {
        if !self.stale {
            return Ok(());
        }
        if self.surface_lost {
            if !self.gpu.wait_idle(PATIENCE) {
                return Ok(());
            }
            self.raw = None;
            self.gpu.renew_surface()?;
            self.surface_lost = false;
        }
        if self.gpu.window_size(self.wanted_size)?.is_none() {
            return Ok(());
        }
        // The device must be idle when the old swapchain is destroyed. While it is busy for long, frames are drawn and
        // not shown.
        if !self.gpu.wait_idle(PATIENCE) {
            return Ok(());
        }
        // The window may have another size by now, and a swapchain of an older one is invalid.
        let Some(size) = self.gpu.window_size(self.wanted_size)? else { return Ok(()) };
        // The old swapchain is unusable after this, even if creating a new one fails.
        let former = self.raw.take();
        self.raw = Some(G::Swapchain::new(&self.gpu, size, self.vsync, former.as_ref())?);
        self.stale = false;
        self.acquired = false;
        Ok(())
    }
}

fn check_output(format: Format, blit: bool) -> Result<(), BackendError> {
    let name = format.name();
    if format == Format::Depth32Float {
        return invalid("the plan's output holds depth-test values, not a picture".to_string());
    }
    if format == Format::R32Uint {
        return invalid(format!(
            "the plan's output has the format {name}, whose integers are not colours: it cannot be shown in a window"
        ));
    }
    if !blit {
        return Err(BackendError::Unsupported(format!(
            "the plan's output has the format {name}, which this device cannot blit to a window"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_output_that_is_no_picture_or_cannot_be_blitted_is_refused_by_its_format() {
        assert!(check_output(Format::Rgba16Float, true).is_ok());
        let integers = check_output(Format::R32Uint, true).unwrap_err().to_string();
        assert!(integers.contains("r32ui") && integers.contains("not colours"), "{integers}");
        let unable = check_output(Format::Rgba32Float, false);
        assert!(unable.unwrap_err().to_string().contains("rgba32f, which this device cannot blit"));
    }
}
