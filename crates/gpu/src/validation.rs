//! The messages of the Vulkan validation layer, kept so that tests can require that there are none.

use std::borrow::Cow;
use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex};

use ash::vk;

use super::lock;

pub(super) const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Messages known to be wrong: (message id, reason). Every entry needs its reason.
const SUPPRESSED: &[(&str, &str)] = &[];

/// Warnings and errors of the validation layer. A clone outlives the device, and so also sees what was not destroyed
/// before it.
#[derive(Clone, Debug, Default)]
pub struct ValidationLog(Arc<Mutex<Vec<String>>>);

impl ValidationLog {
    /// All so far, oldest first.
    pub fn messages(&self) -> Vec<String> {
        lock(&self.0).clone()
    }

    pub(super) fn messenger(&self) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
        vk::DebugUtilsMessengerCreateInfoEXT::default()
            .message_severity(
                vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
            )
            .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
            .pfn_user_callback(Some(record))
            .user_data(Arc::as_ptr(&self.0).cast_mut().cast())
    }
}

unsafe extern "system" fn record(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    log: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes callback data that is valid during the call, or null.
    let data = unsafe { data.as_ref() };
    // SAFETY: `log` is the pointer that `messenger` set; the instance holds the log until its messenger is destroyed.
    let log = unsafe { log.cast_const().cast::<Mutex<Vec<String>>>().as_ref() };
    if let (Some(data), Some(log)) = (data, log) {
        // SAFETY: both are null-terminated strings or null, as the extension requires.
        let (id, text) = unsafe { (string(data.p_message_id_name), string(data.p_message)) };
        if !SUPPRESSED.iter().any(|(suppressed, _)| *suppressed == id) {
            if severity.contains(vk::DebugUtilsMessageSeverityFlagsEXT::ERROR) {
                tracing::error!("validation: {text}");
            } else {
                tracing::warn!("validation: {text}");
            }
            lock(log).push(text.into_owned());
        }
    }
    // True would make the layer abort the call; messages only report.
    vk::FALSE
}

/// # Safety
/// `text` is null or a null-terminated string that outlives the result.
unsafe fn string<'a>(text: *const std::ffi::c_char) -> Cow<'a, str> {
    if text.is_null() {
        return Cow::Borrowed("");
    }
    // SAFETY: not null; the rest is the caller's promise.
    unsafe { CStr::from_ptr(text) }.to_string_lossy()
}
