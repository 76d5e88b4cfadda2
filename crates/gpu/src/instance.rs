//! The Vulkan loader and instance, with the validation layer on request.

use std::ffi::CStr;

use ash::ext::debug_utils;
use ash::{ext, khr, vk};

use super::calls::{Call, Calls, Change};
use super::error::{During, GpuError};
use super::validation::{LAYER, ValidationLog};
use super::{Result, survey};

pub(super) struct Instance {
    raw: ash::Instance,
    messenger: Option<(debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    log: ValidationLog,
    debug_utils: bool,
    /// Whether to destroy it: false for an embedder's instance and for one whose device hangs.
    owned: bool,
    /// The loaded library: every function pointer above points into it, so it goes last.
    _entry: ash::Entry,
}

impl Instance {
    pub(super) fn new(validation: bool) -> Result<Self> {
        // SAFETY: loads the system's Vulkan loader, whose initialisers are trusted as those of any linked library are.
        let entry = unsafe { ash::Entry::load() }.map_err(|source| GpuError::NoLoader(source.into()))?;
        let extensions = instance_extensions(&entry)?;
        let has = |name: &CStr| survey::has_extension(&extensions, name);
        let debug_utils = has(debug_utils::NAME);
        if validation && !has_layer(&entry)? {
            return Err(GpuError::NoValidation("the layer VK_LAYER_KHRONOS_validation"));
        }
        // The layer provides the extension where the loader does not.
        let debug_utils = debug_utils || validation;

        let mut names = Vec::new();
        let mut flags = vk::InstanceCreateFlags::empty();
        if debug_utils {
            names.push(debug_utils::NAME.as_ptr());
        }
        if has(khr::portability_enumeration::NAME) {
            // Also lists devices that implement Vulkan on top of another API (MoltenVK).
            names.push(khr::portability_enumeration::NAME.as_ptr());
            flags |= vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR;
        }
        let layers = [LAYER.as_ptr()];
        let application = vk::ApplicationInfo::default()
            .application_name(c"antirad")
            .engine_name(c"antirad")
            .api_version(survey::API_VERSION);
        let log = ValidationLog::default();
        let mut messenger_info = log.messenger();
        // Checks for hazards between commands as well, which reveal a missing barrier.
        let checks = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&checks);
        // Newer layers check what kernels access only where they are asked to.
        let setting = has_layer_settings(&entry, validation)?;
        if setting {
            names.push(ext::layer_settings::NAME.as_ptr());
        }
        let yes = vk::TRUE.to_ne_bytes();
        let settings = [vk::LayerSettingEXT::default()
            .layer_name(LAYER)
            .setting_name(c"syncval_shader_accesses_heuristic")
            .ty(vk::LayerSettingTypeEXT::BOOL32)
            .values(&yes)];
        let mut settings = vk::LayerSettingsCreateInfoEXT::default().settings(&settings);
        let mut create = vk::InstanceCreateInfo::default()
            .flags(flags)
            .application_info(&application)
            .enabled_extension_names(&names);
        if validation {
            create =
                create.enabled_layer_names(&layers).push_next(&mut features).push_next(&mut messenger_info);
        }
        if setting {
            create = create.push_next(&mut settings);
        }
        let created = {
            let _change = validation.then(Change::begin);
            // SAFETY: all pointers in `create` outlive the call, the extensions and the layer are there.
            unsafe { entry.create_instance(&create, None) }
        };
        let raw = match created {
            Err(vk::Result::ERROR_INCOMPATIBLE_DRIVER) => return Err(survey::no_driver()),
            created => created.during("creating", "instance")?,
        };
        let mut instance = Self { raw, messenger: None, log, debug_utils, owned: true, _entry: entry };
        if validation {
            let _call = Call::begin();
            let utils = debug_utils::Instance::new(&instance._entry, &instance.raw);
            // SAFETY: the extension is enabled; the log that the callback writes to lives as long as the messenger.
            let messenger = unsafe { utils.create_debug_utils_messenger(&instance.log.messenger(), None) }
                .during("creating", "validation messenger")?;
            instance.messenger = Some((utils, messenger));
        }
        Ok(instance)
    }

    /// Wraps an embedder's instance, which stays the embedder's.
    pub(super) fn borrowed(entry: ash::Entry, raw: ash::Instance, debug_utils: bool) -> Self {
        Self { raw, messenger: None, log: ValidationLog::default(), debug_utils, owned: false, _entry: entry }
    }

    pub(super) fn raw(&self) -> Calls<'_, ash::Instance> {
        Calls::of(&self.raw, self.validates())
    }

    /// # Safety
    /// The requirements of [`ash::Instance::create_device`] hold.
    pub(super) unsafe fn create_device(
        &self,
        physical: vk::PhysicalDevice,
        create: &vk::DeviceCreateInfo,
    ) -> ash::prelude::VkResult<ash::Device> {
        let _change = self.validates().then(Change::begin);
        // SAFETY: the caller's.
        unsafe { self.raw.create_device(physical, create, None) }
    }

    pub(super) fn log(&self) -> &ValidationLog {
        &self.log
    }

    /// Whether the validation layer reports to the log.
    pub(super) fn validates(&self) -> bool {
        self.messenger.is_some()
    }

    pub(super) fn debug_utils(&self) -> bool {
        self.debug_utils
    }

    /// Leaks the instance, with the library and the log that it points to.
    pub(super) fn abandon(&mut self) {
        self.owned = false;
        std::mem::forget(self._entry.clone());
        std::mem::forget(self.log.clone());
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if !self.owned {
            return;
        }
        if let Some((utils, messenger)) = &self.messenger {
            let _call = Call::begin();
            // SAFETY: made by `new` with this instance.
            unsafe { utils.destroy_debug_utils_messenger(*messenger, None) };
        }
        let _change = self.validates().then(Change::begin);
        // SAFETY: made by `new`; the devices made from it hold it and were destroyed before.
        unsafe { self.raw.destroy_instance(None) };
    }
}

fn instance_extensions(entry: &ash::Entry) -> Result<Vec<vk::ExtensionProperties>> {
    // SAFETY: a query without preconditions.
    unsafe { entry.enumerate_instance_extension_properties(None) }
        .during("listing the extensions of", "instance")
}

/// Whether the validation layer is wanted and takes settings.
fn has_layer_settings(entry: &ash::Entry, validation: bool) -> Result<bool> {
    if !validation {
        return Ok(false);
    }
    // SAFETY: a query without preconditions.
    let extensions = unsafe { entry.enumerate_instance_extension_properties(Some(LAYER)) }
        .during("listing the extensions of", "validation layer")?;
    Ok(survey::has_extension(&extensions, ext::layer_settings::NAME))
}

fn has_layer(entry: &ash::Entry) -> Result<bool> {
    // SAFETY: a query without preconditions.
    let layers =
        unsafe { entry.enumerate_instance_layer_properties() }.during("listing the layers of", "instance")?;
    Ok(layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(LAYER)))
}
