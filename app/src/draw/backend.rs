//! Chooses the graphics backend: a [`Backend`] holds a device of the chosen API, and forwards every call to it.
//!
//! Each build contains Vulkan and the null device, and on Apple's systems Metal; `--backend` selects one.

use splatgraph_api::{
    BackendError, Compiled, Device, DeviceInfo, DeviceMemory, FrameId, FrameInputs, FrameResult, Heap,
    Picture, Progress, Running, SceneData,
};
use splatgraph_framework::dump::{self, Dump};
use splatgraph_framework::plan::Plan;
use splatgraph_framework::shader::Cancel;
#[cfg(target_vendor = "apple")]
use splatgraph_metal::Metal;
use splatgraph_null::{Config, Null};
use splatgraph_vulkan::Vulkan;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

pub use splatgraph_api::{Options, Validation};
pub use splatgraph_metal::dump::add_encoders as add_metal_encoders;
pub use splatgraph_runtime::{Window, abandoned_compilers};
pub use splatgraph_vulkan::sync;

/// Dumps a plan with its Vulkan barriers.
///
/// If no valid barriers are found, the dump contains a warning instead. A Vulkan device refuses to load such a plan.
pub fn dump(plan: &Plan) -> Dump {
    sync::dump::add_barriers(dump::dump(plan), plan, sync::barriers(plan).as_ref())
}

/// A graphics API, as named by `--backend`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Api {
    /// Vulkan 1.3, on every system with a driver.
    Vulkan,
    /// Metal, on Apple's systems.
    #[cfg(target_vendor = "apple")]
    Metal,
    /// No graphics API: the device accepts every call and executes nothing.
    Null,
}

impl Api {
    /// The APIs that this program contains.
    #[cfg(target_vendor = "apple")]
    pub const ALL: [Api; 3] = [Api::Metal, Api::Vulkan, Api::Null];
    /// The APIs that this program contains.
    #[cfg(not(target_vendor = "apple"))]
    pub const ALL: [Api; 2] = [Api::Vulkan, Api::Null];

    /// Returns the API's name as a value of `--backend`.
    pub fn name(self) -> &'static str {
        match self {
            Api::Vulkan => "vulkan",
            #[cfg(target_vendor = "apple")]
            Api::Metal => "metal",
            Api::Null => "null",
        }
    }

    /// Finds an API by its name.
    ///
    /// # Errors
    /// The name is unknown. The error lists the valid names.
    pub fn parse(name: &str) -> Result<Api, String> {
        Api::find(name).ok_or_else(|| Api::refusal(name, &[]))
    }

    /// Finds an API by its name; `None` if the name is unknown.
    pub fn find(name: &str) -> Option<Api> {
        Api::ALL.into_iter().find(|api| api.name() == name)
    }

    /// Formats the error about a name that is neither an API nor one of `others`.
    pub fn refusal(name: &str, others: &[&str]) -> String {
        refusal(name, &[&Api::ALL.map(Api::name), others].concat())
    }

    /// Lists the names of the APIs that draw pictures.
    pub fn drawing() -> Vec<&'static str> {
        Api::ALL.into_iter().filter(|api| *api != Api::Null).map(Api::name).collect()
    }

    /// Finds, by its name, an API that draws pictures.
    ///
    /// # Errors
    /// The name is unknown, or that of [`Api::Null`]. The error lists the APIs that draw.
    pub fn parse_drawing(name: &str) -> Result<Api, String> {
        Api::find(name).filter(|api| *api != Api::Null).ok_or_else(|| refusal(name, &Api::drawing()))
    }

    /// Lists the devices that the API finds on this machine.
    ///
    /// # Errors
    /// The API is not installed, or its devices cannot be listed.
    pub fn devices(self) -> Result<Vec<DeviceInfo>, BackendError> {
        match self {
            Api::Vulkan => Vulkan::devices(),
            #[cfg(target_vendor = "apple")]
            Api::Metal => Metal::devices(),
            Api::Null => Null::devices(),
        }
    }
}

fn refusal(name: &str, names: &[&str]) -> String {
    let why = match name {
        "metal" => ": Metal exists only on Apple's systems",
        "null" => ": it draws no pictures to compare",
        _ => "",
    };
    format!("expected {}, found {name}{why}", alternatives(names))
}

/// Joins names as alternatives: `vulkan, null or reference`.
fn alternatives(names: &[&str]) -> String {
    match names {
        [first @ .., last] if !first.is_empty() => format!("{} or {last}", first.join(", ")),
        _ => names.concat(),
    }
}

impl Default for Api {
    fn default() -> Api {
        Api::ALL[0]
    }
}

impl fmt::Display for Api {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An opened device, and the plan that it executes once one was swapped in.
pub enum Backend {
    /// A Vulkan device.
    Vulkan(Vulkan),
    /// A Metal device.
    #[cfg(target_vendor = "apple")]
    Metal(Metal),
    /// A device that executes nothing.
    Null(Null),
}

/// Loader of a [`Backend`].
pub enum Loader {
    /// Loader of a Vulkan device.
    Vulkan(<Vulkan as Device>::Loader),
    /// Loader of a Metal device.
    #[cfg(target_vendor = "apple")]
    Metal(<Metal as Device>::Loader),
    /// Loader of the null device.
    Null(<Null as Device>::Loader),
}

/// A plan prepared for one [`Backend`].
pub enum Ready {
    /// Plan for a Vulkan device.
    Vulkan(ReadyOf<Vulkan>),
    /// Plan for a Metal device.
    #[cfg(target_vendor = "apple")]
    Metal(ReadyOf<Metal>),
    /// Plan for the null device.
    Null(ReadyOf<Null>),
}

type ReadyOf<D> = <<D as Device>::Loader as splatgraph_api::Loader>::Ready;

macro_rules! each {
    ($backend:expr, $device:ident => $call:expr) => {
        match $backend {
            Backend::Vulkan($device) => $call,
            #[cfg(target_vendor = "apple")]
            Backend::Metal($device) => $call,
            Backend::Null($device) => $call,
        }
    };
}

/// Evaluates `$call` on the contents of a `$from`. Wraps the result in the variant of `$to` for the same API.
macro_rules! wrapped {
    ($value:expr, $from:ident => $to:ident, $own:ident => $call:expr) => {
        match $value {
            $from::Vulkan($own) => $to::Vulkan($call),
            #[cfg(target_vendor = "apple")]
            $from::Metal($own) => $to::Metal($call),
            $from::Null($own) => $to::Null($call),
        }
    };
}

impl Backend {
    /// Opens a device.
    ///
    /// # Errors
    /// [`BackendError::Unavailable`] if a driver, the validation layer or a suitable device is missing, or if the API
    /// has no such validation.
    pub fn open(api: Api, options: &Options) -> Result<Backend, BackendError> {
        Backend::open_telling(api, options, &mut |_| {})
    }

    /// Opens a device, and calls `chosen` with its description: before the device is created, except
    /// for the null device. A plan for it can be built meanwhile, on another thread.
    ///
    /// # Errors
    /// See [`Backend::open`].
    pub fn open_telling(
        api: Api,
        options: &Options,
        chosen: &mut dyn FnMut(&DeviceInfo),
    ) -> Result<Backend, BackendError> {
        match api {
            Api::Vulkan => Vulkan::open_telling(options, chosen).map(Backend::Vulkan),
            #[cfg(target_vendor = "apple")]
            Api::Metal => Metal::open_telling(options, chosen).map(Backend::Metal),
            Api::Null => null(options, None).inspect(|device| chosen(device.info())),
        }
    }

    /// Opens a device that presents its frames in `window`. Call it on the main thread.
    ///
    /// `size` is the window's current size, in pixels.
    ///
    /// # Errors
    /// See [`Backend::open`]; [`BackendError::Unavailable`] if the device cannot present in the window.
    pub fn open_in_window(
        api: Api,
        options: &Options,
        window: Arc<impl Window + 'static>,
        size: (u32, u32),
    ) -> Result<Backend, BackendError> {
        match api {
            Api::Vulkan => Vulkan::open_in_window(options, window, size).map(Backend::Vulkan),
            #[cfg(target_vendor = "apple")]
            Api::Metal => Metal::open_in_window(options, window, size).map(Backend::Metal),
            Api::Null => null(options, Some(size)),
        }
    }

    /// Opens a second device that does not delay this device's frames, for example to draw beside a window.
    ///
    /// Returns a new context of this device, and ignores `options`. A Vulkan device on a CPU is instead opened again
    /// with `options`, in its own instance: devices of one instance would share a queue and threads.
    ///
    /// # Errors
    /// See [`Backend::open`].
    pub fn open_beside(&self, options: &Options) -> Result<Backend, BackendError> {
        match self {
            Backend::Vulkan(device) if device.info().is_cpu() => {
                let device = Some(device.info().index.to_string());
                Backend::open(Api::Vulkan, &Options { device, ..options.clone() })
            }
            _ => self.new_context(),
        }
    }

    /// Closes the device, and returns its remaining validation messages, including messages about closing it.
    pub fn close(self) -> Vec<String> {
        each!(self, device => device.close())
    }

    /// Returns the memory use of the device, including that of other contexts on it.
    pub fn device_memory(&self) -> DeviceMemory {
        each!(self, device => device.device_memory())
    }
}

fn null(options: &Options, window: Option<(u32, u32)>) -> Result<Backend, BackendError> {
    if options.validation != Validation::Off {
        let why =
            "expected a backend with validation, found null: it executes nothing that could be validated";
        return Err(BackendError::Unavailable(why.to_owned()));
    }
    let devices = Null::devices()?;
    splatgraph_runtime::choose(&devices.iter().collect::<Vec<_>>(), options.device.as_deref())?;
    // Generous: on a busy machine, even the null device's threads wait for a processor.
    const PATIENCE: Duration = Duration::from_secs(60);
    let config = Config {
        window,
        records: false,
        patience: PATIENCE,
        compile_patience: PATIENCE,
        ..Config::default()
    };
    splatgraph_null::open(&config).0.map(Backend::Null)
}

impl splatgraph_api::Loader for Loader {
    type Ready = Ready;

    fn cancelled_by(self, cancel: Cancel) -> Self {
        wrapped!(self, Loader => Loader, loader => loader.cancelled_by(cancel))
    }

    fn sharing_results(self) -> Self {
        wrapped!(self, Loader => Loader, loader => loader.sharing_results())
    }

    fn clearing_histories(self) -> Self {
        wrapped!(self, Loader => Loader, loader => loader.clearing_histories())
    }

    fn keeping_state(self) -> Self {
        wrapped!(self, Loader => Loader, loader => loader.keeping_state())
    }

    fn restoring_histories(self) -> Self {
        wrapped!(self, Loader => Loader, loader => loader.restoring_histories())
    }

    fn compile(self, plan: Plan) -> Result<Compiled, BackendError> {
        match self {
            Loader::Vulkan(loader) => loader.compile(plan),
            #[cfg(target_vendor = "apple")]
            Loader::Metal(loader) => loader.compile(plan),
            Loader::Null(loader) => loader.compile(plan),
        }
    }

    fn prepare(
        self,
        plan: Plan,
        scene: &dyn SceneData,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Ready, BackendError> {
        Ok(wrapped!(self, Loader => Ready, loader => loader.prepare(plan, scene, progress)?))
    }
}

impl Device for Backend {
    type Loader = Loader;

    fn info(&self) -> &DeviceInfo {
        each!(self, device => device.info())
    }

    fn new_context(&self) -> Result<Self, BackendError> {
        Ok(wrapped!(self, Backend => Backend, device => device.new_context()?))
    }

    fn shares_device(&self, other: &Self) -> bool {
        match (self, other) {
            (Backend::Vulkan(one), Backend::Vulkan(other)) => one.shares_device(other),
            #[cfg(target_vendor = "apple")]
            (Backend::Metal(one), Backend::Metal(other)) => one.shares_device(other),
            (Backend::Null(one), Backend::Null(other)) => one.shares_device(other),
            _ => false,
        }
    }

    fn loader(&self) -> Loader {
        wrapped!(self, Backend => Loader, device => device.loader())
    }

    fn swap(&mut self, ready: Ready) -> Result<(), BackendError> {
        match (self, ready) {
            (Backend::Vulkan(device), Ready::Vulkan(ready)) => device.swap(ready),
            #[cfg(target_vendor = "apple")]
            (Backend::Metal(device), Ready::Metal(ready)) => device.swap(ready),
            (Backend::Null(device), Ready::Null(ready)) => device.swap(ready),
            _ => Err(BackendError::Invalid("a plan was prepared for a device of another API".to_owned())),
        }
    }

    fn picture(&self) -> Option<Picture> {
        each!(self, device => device.picture())
    }

    fn submit(&mut self, inputs: &FrameInputs) -> Result<FrameId, BackendError> {
        each!(self, device => device.submit(inputs))
    }

    fn missed_window(&self) -> bool {
        each!(self, device => device.missed_window())
    }

    fn resize_window(&mut self, width: u32, height: u32) {
        each!(self, device => device.resize_window(width, height));
    }

    fn set_vsync(&mut self, vsync: bool) {
        each!(self, device => device.set_vsync(vsync));
    }

    fn wait(&mut self, frame: FrameId) -> Result<FrameResult, BackendError> {
        each!(self, device => device.wait(frame))
    }

    fn try_wait(&mut self, frame: FrameId) -> Result<Option<FrameResult>, BackendError> {
        each!(self, device => device.try_wait(frame))
    }

    fn is_ready(&mut self) -> Result<bool, BackendError> {
        each!(self, device => device.is_ready())
    }

    fn running(&mut self) -> Option<Running> {
        each!(self, device => device.running())
    }

    fn memory(&self) -> Vec<(String, u64)> {
        each!(self, device => device.memory())
    }

    fn heap(&self) -> Heap {
        each!(self, device => device.heap())
    }

    fn take_messages(&mut self) -> Vec<String> {
        each!(self, device => device.take_messages())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_backend_is_found_by_its_name() {
        for api in Api::ALL {
            assert_eq!(Api::parse(api.name()), Ok(api));
        }
    }

    #[cfg(not(target_vendor = "apple"))]
    #[test]
    fn a_backend_that_is_not_there_is_refused_with_those_that_are_and_the_reason() {
        let expected = "expected vulkan or null, found metal: Metal exists only on Apple's systems";
        assert_eq!(Api::parse("metal").unwrap_err(), expected);
        let expected = "expected vulkan, null or reference, found opengl";
        assert_eq!(Api::refusal("opengl", &["reference"]), expected);
        assert_eq!(Api::default(), Api::Vulkan);
        assert_eq!(Api::parse_drawing("vulkan"), Ok(Api::Vulkan));
        let refused = |name| Api::parse_drawing(name).unwrap_err();
        assert_eq!(refused("null"), "expected vulkan, found null: it draws no pictures to compare");
        assert_eq!(refused("metal"), "expected vulkan, found metal: Metal exists only on Apple's systems");
    }

    #[test]
    fn the_device_that_executes_nothing_is_opened_by_its_own_name_alone() {
        let options = |device: &str| Options { device: Some(device.to_owned()), ..Options::default() };
        let opened = |device: &str| {
            Backend::open(Api::Null, &options(device)).map(|device| device.info().name.clone())
        };
        assert_eq!(opened("null").unwrap(), "null");
        assert_eq!(opened("0").unwrap(), "null");
        let error = opened("llvmpipe").unwrap_err().to_string();
        assert!(error.contains("there is no device `llvmpipe`; available: 0: null"), "{error}");
        let validated = Options { validation: Validation::Synchronization, ..Options::default() };
        let error = Backend::open(Api::Null, &validated).err().expect("refused").to_string();
        assert!(error.contains("expected a backend with validation, found null"), "{error}");
    }
}
