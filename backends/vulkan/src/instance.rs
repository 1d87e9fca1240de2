//! Creates the Vulkan instance: opens the loader, enables the validation layer, and collects its messages.
//!
//! The loader is opened at run time, so that the program starts on a machine without Vulkan and can report what is
//! missing. Only an instance created for a window enables a window system's extensions.

use crate::error::api;
use crate::surface::{self, Surface};
use ash::{ext, khr, vk};
use splatgraph_api::{BackendError, Validation};
use splatgraph_runtime::{Messages, Window, lock};
use std::ffi::{CStr, OsString, c_char, c_void};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};

const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

const NO_DRIVER: &str = if cfg!(target_os = "macos") {
    "the Vulkan loader finds no driver that works; MoltenVK, which is in the Vulkan SDK and in Homebrew's package \
     `molten-vk`, is one for macOS. `--backend metal` needs none"
} else if cfg!(windows) {
    "the Vulkan loader finds no driver that works; on Windows it comes with the driver of the graphics card"
} else {
    "the Vulkan loader finds no driver that works; on Debian and Ubuntu the package `mesa-vulkan-drivers` has drivers \
     for many GPUs, and one that runs on the CPU; NVIDIA's comes with its own driver (and needs `libx11-6` and \
     `libxext6`, also without a display)"
};

const LOADER_SOURCE: &str = if cfg!(target_os = "macos") {
    "on macOS it is in the Vulkan SDK. `--backend metal` needs none"
} else if cfg!(windows) {
    "on Windows it comes with the driver of the graphics card"
} else {
    "on Debian and Ubuntu it is in the package `libvulkan1`, a driver that needs no GPU in `mesa-vulkan-drivers`"
};

/// Returns the error for a machine without a working driver, or with an environment variable that hides its drivers.
pub(crate) fn no_driver() -> BackendError {
    let set = |name| Some((name, std::env::var_os(name)?));
    no_driver_in(["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].into_iter().find_map(set))
}

/// Returns the error for a loader that searched the files of `variable` or, with `None`, its default folders.
pub(crate) fn no_driver_in(variable: Option<(&str, OsString)>) -> BackendError {
    BackendError::Unavailable(match variable {
        Some((name, files)) if files.is_empty() => {
            format!("{name} is set, but empty, which hides all drivers from the Vulkan loader: unset it")
        }
        Some((name, files)) => format!(
            "the Vulkan loader finds no driver that works in {name}={}, and looks nowhere else: name the manifest of a \
             driver (a .json file), or unset {name}",
            files.display()
        ),
        None => NO_DRIVER.to_string(),
    })
}

/// The oldest version with all functions and features that this crate relies on, such as synchronization2, dynamic
/// rendering and maintenance4.
pub(crate) const API_VERSION: u32 = vk::API_VERSION_1_3;

/// A Vulkan instance, destroyed on drop. Everything created from it must be destroyed first.
pub(crate) struct Instance {
    pub raw: ash::Instance,
    /// True if objects and command buffers can be named (`VK_EXT_debug_utils`).
    pub labels: bool,
    pub messages: Arc<Messages>,
    // Dropped after the surface.
    window: Option<Arc<dyn Window>>,
    surface: Mutex<Option<Arc<Surface>>>,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
}

impl Instance {
    pub fn in_window(validation: Validation, window: Arc<dyn Window>) -> Result<Instance, BackendError> {
        let extensions = surface::extensions(&*window)?;
        let mut instance = Instance::new(validation, &extensions)?;
        instance.window = Some(window);
        instance.renew_surface()?;
        Ok(instance)
    }

    /// Returns true if a device has an extension; false also if the query fails.
    pub fn has_extension(&self, device: vk::PhysicalDevice, name: &CStr) -> bool {
        // SAFETY: the device is one of the instance's.
        let extensions = unsafe { self.raw.enumerate_device_extension_properties(device) };
        extensions.is_ok_and(|extensions| offers(&extensions, name))
    }

    pub fn surface(&self) -> Option<Arc<Surface>> {
        lock(&self.surface).clone()
    }

    /// Creates the window's surface, or recreates it. All swapchains of the previous surface must have been dropped.
    /// Does nothing without a window.
    pub fn renew_surface(&self) -> Result<(), BackendError> {
        let Some(window) = self.window.as_deref() else { return Ok(()) };
        let mut surface = lock(&self.surface);
        // A window has one surface at a time. If the new one cannot be created, none is left until the next attempt.
        *surface = None;
        *surface = Some(Arc::new(Surface::new(loader()?, &self.raw, window)?));
        Ok(())
    }

    /// Creates an instance with `extensions` (such as a window system's) in addition to the crate's own.
    pub fn new(validation: Validation, extensions: &[&CStr]) -> Result<Instance, BackendError> {
        let entry = loader()?;
        check_version(entry)?;
        // The layer, not the loader, lists its extensions.
        let layer_extensions = match validation {
            Validation::Off => Vec::new(),
            _ => validation_layer(entry)?,
        };
        let layers: &[*const c_char] = if validation == Validation::Off { &[] } else { &[LAYER.as_ptr()] };

        let offered = instance_extensions(entry, None)?;
        let labels =
            offers(&offered, ext::debug_utils::NAME) || offers(&layer_extensions, ext::debug_utils::NAME);
        let mut names: Vec<*const c_char> = extensions.iter().map(|name| name.as_ptr()).collect();
        if labels {
            names.push(ext::debug_utils::NAME.as_ptr());
        }
        // Without this flag, the loader hides drivers that implement only a subset of Vulkan, such as MoltenVK.
        let mut flags = vk::InstanceCreateFlags::empty();
        if offers(&offered, khr::portability_enumeration::NAME) {
            names.push(khr::portability_enumeration::NAME.as_ptr());
            flags = vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
        }

        let messages = Arc::new(Messages::default());
        let mut messenger_info = messenger_info(&messages);
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let settings = synchronization_settings();
        let mut settings = vk::LayerSettingsCreateInfoEXT::default().settings(&settings);

        let application = vk::ApplicationInfo::default()
            .application_name(c"splatgraph")
            .engine_name(c"splatgraph")
            .api_version(API_VERSION);
        let mut info = vk::InstanceCreateInfo::default()
            .flags(flags)
            .application_info(&application)
            .enabled_layer_names(layers);
        if validation != Validation::Off && labels {
            // Reports messages during creation and destruction of the instance as well.
            info = info.push_next(&mut messenger_info);
        }
        if validation == Validation::Synchronization {
            // Older layers have `VK_EXT_validation_features` instead of `VK_EXT_layer_settings`. The latter is not
            // enabled by name: the layer reads the settings anyway, and a loader older than the layer refuses the name.
            if offers(&layer_extensions, ext::layer_settings::NAME) {
                info = info.push_next(&mut settings);
            } else {
                names.push(ext::validation_features::NAME.as_ptr());
                info = info.push_next(&mut features);
            }
        }
        let info = info.enabled_extension_names(&names);
        // SAFETY: everything that `info` points to lives until the call returns; the messenger's user data lives in the
        // `Arc` that the instance keeps.
        let raw = changing_devices(|| unsafe { entry.create_instance(&info, None) });
        let missing = extensions.iter().find(|name| !offers(&offered, name));
        let raw = raw.map_err(|answer| match (answer, missing) {
            (vk::Result::ERROR_INCOMPATIBLE_DRIVER, _) => no_driver(),
            // The loader returns this only if it found a driver.
            (vk::Result::ERROR_EXTENSION_NOT_PRESENT, Some(name)) => BackendError::Unavailable(format!(
                "no Vulkan driver here can show pictures in a window of this window system: none has {}",
                name.to_string_lossy()
            )),
            _ => api("vkCreateInstance")(answer),
        })?;
        let mut instance =
            Instance { raw, labels, messages, window: None, surface: Mutex::default(), messenger: None };
        if validation != Validation::Off && labels {
            instance.listen(entry)?;
        }
        Ok(instance)
    }

    fn listen(&mut self, entry: &ash::Entry) -> Result<(), BackendError> {
        let functions = ext::debug_utils::Instance::new(entry, &self.raw);
        let info = messenger_info(&self.messages);
        // SAFETY: the user data lives in `self.messages`, and the messenger is destroyed before it in `drop`.
        let messenger = unsafe { functions.create_debug_utils_messenger(&info, None) }
            .map_err(api("vkCreateDebugUtilsMessengerEXT"))?;
        self.messenger = Some((functions, messenger));
        Ok(())
    }

    pub fn physical_devices(&self) -> Result<Vec<vk::PhysicalDevice>, BackendError> {
        // SAFETY: queries a live instance.
        unsafe { self.raw.enumerate_physical_devices() }.map_err(api("vkEnumeratePhysicalDevices"))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        *self.surface.get_mut().unwrap_or_else(PoisonError::into_inner) = None;
        // SAFETY: everything created from the instance keeps it alive, so nothing is left. `messages` is dropped after
        // this, because the destruction itself may report messages.
        unsafe {
            if let Some((functions, messenger)) = self.messenger.take() {
                functions.destroy_debug_utils_messenger(messenger, None);
            }
            changing_devices(|| self.raw.destroy_instance(None));
        }
    }
}

/// Lock on the loader's list of devices, which all instances of a process share. Naming an object, creating a swapchain
/// and looking up a device function search the list; opening and closing a device change it. The loader does not
/// synchronize them (KhronosGroup/Vulkan-Loader, issues 200 and 2018), so a thread could read a device that another
/// has freed.
static DEVICES: RwLock<()> = RwLock::new(());

/// Opens or closes an instance or a device, with exclusive access to the loader's list of devices.
pub fn changing_devices<T>(change: impl FnOnce() -> T) -> T {
    let _guard = DEVICES.write().unwrap_or_else(PoisonError::into_inner);
    change()
}

/// Calls a function that searches the loader's list of devices, with shared access to it.
pub fn searching_devices<T>(search: impl FnOnce() -> T) -> T {
    let _guard = DEVICES.read().unwrap_or_else(PoisonError::into_inner);
    search()
}

/// Returns the Vulkan loader. The first call opens it; a failure is kept, too. It is never closed, because drivers may
/// leave threads and thread-local data behind.
fn loader() -> Result<&'static ash::Entry, BackendError> {
    static LOADER: OnceLock<Result<ash::Entry, String>> = OnceLock::new();
    LOADER
        // SAFETY: the system's Vulkan loader is trusted.
        .get_or_init(|| unsafe { ash::Entry::load() }.map_err(|e| e.to_string()))
        .as_ref()
        .map_err(|why| {
            BackendError::Unavailable(format!("there is no Vulkan loader ({why}); {LOADER_SOURCE}"))
        })
}

fn check_version(entry: &ash::Entry) -> Result<(), BackendError> {
    // SAFETY: a query without arguments.
    let version = unsafe { entry.try_enumerate_instance_version() }
        .map_err(api("vkEnumerateInstanceVersion"))?
        .unwrap_or(vk::API_VERSION_1_0);
    if version < API_VERSION {
        return Err(BackendError::Unavailable(format!(
            "the Vulkan loader has version {}.{}, but 1.3 is needed",
            vk::api_version_major(version),
            vk::api_version_minor(version)
        )));
    }
    Ok(())
}

/// Returns the validation layer's extensions, or an error with advice on installing the layer.
fn validation_layer(entry: &ash::Entry) -> Result<Vec<vk::ExtensionProperties>, BackendError> {
    // SAFETY: a query without arguments.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }
        .map_err(api("vkEnumerateInstanceLayerProperties"))?;
    if !layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(LAYER)) {
        return Err(BackendError::Unavailable(
            "validation was requested, but VK_LAYER_KHRONOS_validation is not installed; on Debian and Ubuntu it is \
             in the package `vulkan-validationlayers`"
                .to_string(),
        ));
    }
    instance_extensions(entry, Some(LAYER))
}

fn instance_extensions(
    entry: &ash::Entry,
    layer: Option<&CStr>,
) -> Result<Vec<vk::ExtensionProperties>, BackendError> {
    // SAFETY: `layer` is a C string or none.
    unsafe { entry.enumerate_instance_extension_properties(layer) }
        .map_err(|answer| match answer {
            // The loader returns this for manifests that it cannot read.
            vk::Result::ERROR_OUT_OF_HOST_MEMORY => BackendError::Unavailable(format!(
                "expected manifests of drivers and layers that the Vulkan loader can read, found one that it cannot, or too \
                 little memory for it (vkEnumerateInstanceExtensionProperties returned {answer:?}; VK_LOADER_DEBUG=all names the files)"
            )),
            answer => api("vkEnumerateInstanceExtensionProperties")(answer),
        })
}

fn offers(extensions: &[vk::ExtensionProperties], name: &CStr) -> bool {
    extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name))
}

/// Returns the layer settings that enable synchronization validation and its check of shader accesses, which newer
/// layers omit by default.
fn synchronization_settings() -> [vk::LayerSettingEXT<'static>; 2] {
    static YES: vk::Bool32 = vk::TRUE;
    [c"validate_sync", c"syncval_shader_accesses_heuristic"].map(|name| vk::LayerSettingEXT {
        p_layer_name: LAYER.as_ptr(),
        p_setting_name: name.as_ptr(),
        ty: vk::LayerSettingTypeEXT::BOOL32,
        value_count: 1,
        p_values: (&raw const YES).cast(),
        ..Default::default()
    })
}

/// Returns the settings of the messenger: warnings and errors of validation and performance.
///
/// The message type `GENERAL` is left out: it is the loader's log of drivers and layers, not about the program.
fn messenger_info(messages: &Arc<Messages>) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(
            vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
        )
        .message_type(
            vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
        )
        .pfn_user_callback(Some(collect))
        .user_data(Arc::as_ptr(messages).cast_mut().cast())
}

/// Adds a message to the collection. The layer calls it on the thread that made the Vulkan call.
unsafe extern "system" fn collect(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: `user` is the `Messages` given in `messenger_info`, which outlives the instance. `data`, if not null, and
    // its strings are valid during this call.
    unsafe {
        let messages = &*user.cast::<Messages>();
        if let Some(data) = data.as_ref() {
            let severity = if severity.contains(vk::DebugUtilsMessageSeverityFlagsEXT::ERROR) {
                "error"
            } else {
                "warning"
            };
            let text = data.message_as_c_str().map(CStr::to_string_lossy).unwrap_or_default();
            let mut labels: Vec<_> = if data.p_cmd_buf_labels.is_null() {
                Vec::new()
            } else {
                std::slice::from_raw_parts(data.p_cmd_buf_labels, data.cmd_buf_label_count as usize)
                    .iter()
                    .filter_map(|label| label.label_name_as_c_str())
                    .map(CStr::to_string_lossy)
                    .collect()
            };
            // Some layers list every label twice.
            labels.dedup();
            let place =
                if labels.is_empty() { String::new() } else { format!(" (in {})", labels.join(", ")) };
            // Older layers repeat the identifier in the text.
            let id = data.message_id_name_as_c_str().map(CStr::to_string_lossy).unwrap_or_default();
            let id = if id.is_empty() || text.contains(&*id) { String::new() } else { format!(" {id}") };
            messages.add(format!("{severity}{id}{place}: {text}"));
        }
    }
    vk::FALSE
}
