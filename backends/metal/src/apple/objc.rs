//! Wraps Objective-C calls that the `metal` crate lacks, or whose failure it does not report.
//!
//! Messages are sent with the types of Apple's headers. Objects that can be `nil` are returned as `Option`s. Methods
//! whose name begins with `new` return retained objects, which their wrapper releases; all other objects belong to the
//! caller's autorelease pool, which must exist.

use metal::foreign_types::ForeignType;
use metal::objc::runtime::{BOOL, Object, YES};
use metal::objc::{class, msg_send, sel, sel_impl};
use metal::*;
use std::ffi::{CStr, CString, c_char, c_void};
use std::path::Path;
use std::ptr::NonNull;

pub(crate) fn pool<T>(body: impl FnOnce() -> T) -> T {
    metal::objc::rc::autoreleasepool(body)
}

pub(crate) fn new_queue(device: &DeviceRef) -> Option<CommandQueue> {
    // SAFETY: the method takes no arguments, and returns a retained object or nil.
    let raw: *mut MTLCommandQueue = unsafe { msg_send![device, newCommandQueue] };
    // SAFETY: the pointer is not null, and this is its only owner.
    (!raw.is_null()).then(|| unsafe { CommandQueue::from_ptr(raw) })
}

/// Creates a command buffer that retains the objects its commands use; `None` if Metal returns none.
pub(crate) fn command_buffer(queue: &CommandQueueRef) -> Option<CommandBuffer> {
    // SAFETY: the method takes no arguments, and returns an autoreleased object or nil.
    let raw: *mut MTLCommandBuffer = unsafe { msg_send![queue, commandBuffer] };
    if raw.is_null() {
        return None;
    }
    // SAFETY: the object is alive until the pool ends. The wrapper releases what is retained here.
    unsafe {
        let _: *mut Object = msg_send![raw.cast::<Object>(), retain];
        Some(CommandBuffer::from_ptr(raw))
    }
}

pub(crate) fn new_heap(device: &DeviceRef, descriptor: &HeapDescriptorRef) -> Option<Heap> {
    // SAFETY: the descriptor is alive, and the method returns a retained object or nil.
    let raw: *mut MTLHeap = unsafe { msg_send![device, newHeapWithDescriptor: descriptor] };
    // SAFETY: the pointer is not null, and this is its only owner.
    (!raw.is_null()).then(|| unsafe { Heap::from_ptr(raw) })
}

pub(crate) fn new_buffer(device: &DeviceRef, bytes: u64, options: MTLResourceOptions) -> Option<Buffer> {
    // SAFETY: the argument types match the method's, which returns a retained object or nil.
    let raw: *mut MTLBuffer = unsafe { msg_send![device, newBufferWithLength: bytes options: options] };
    // SAFETY: the pointer is not null, and this is its only owner.
    (!raw.is_null()).then(|| unsafe { Buffer::from_ptr(raw) })
}

pub(crate) fn max_buffer_length(device: &DeviceRef) -> u64 {
    // SAFETY: a property of type NSUInteger.
    unsafe { msg_send![device, maxBufferLength] }
}

pub(crate) fn allocated_bytes(device: &DeviceRef) -> u64 {
    // SAFETY: a property of type NSUInteger.
    unsafe { msg_send![device, currentAllocatedSize] }
}

/// Returns true if samplers can interpolate images of 32-bit floats.
pub(crate) fn filters_floats(device: &DeviceRef) -> bool {
    // SAFETY: a property of type BOOL.
    let answer: BOOL = unsafe { msg_send![device, supports32BitFloatFiltering] };
    answer == YES
}

/// Returns the name and version of the operating system.
pub(crate) fn system() -> String {
    pool(|| {
        // SAFETY: a class of Foundation, which is linked, and one of its string properties.
        let text: *mut Object = unsafe {
            let process: *mut Object = msg_send![class!(NSProcessInfo), processInfo];
            msg_send![process, operatingSystemVersionString]
        };
        string(text)
    })
}

/// Returns true on the main thread, the only one that may change views.
pub(crate) fn is_main_thread() -> bool {
    // SAFETY: a class method that takes no arguments and returns a BOOL.
    let answer: BOOL = unsafe { msg_send![class!(NSThread), isMainThread] };
    answer == YES
}

pub(crate) fn memory_barrier(encoder: &ComputeCommandEncoderRef, buffers: bool, textures: bool) {
    // MTLBarrierScopeBuffers and MTLBarrierScopeTextures.
    let scope = u64::from(buffers) | u64::from(textures) << 1;
    // SAFETY: the encoder is open, and the scope is one of the enumeration's sets.
    unsafe { msg_send![encoder, memoryBarrierWithScope: scope] }
}

pub(crate) fn status(commands: &CommandBufferRef) -> u64 {
    // SAFETY: a property of type NSUInteger.
    unsafe { msg_send![commands, status] }
}

pub(crate) fn error(commands: &CommandBufferRef) -> (i64, String) {
    pool(|| {
        // SAFETY: a property that is an error or nil.
        let error: *mut Object = unsafe { msg_send![commands, error] };
        if error.is_null() {
            return (0, "it gives no reason".to_string());
        }
        // SAFETY: the error is alive until the pool ends; a code of type NSInteger and a string.
        let (code, text): (i64, *mut Object) =
            unsafe { (msg_send![error, code], msg_send![error, localizedDescription]) };
        (code, string(text))
    })
}

/// Returns the times, in seconds, at which the device started and finished a completed command buffer. They are 0 if
/// Metal reports none.
pub(crate) fn device_times(commands: &CommandBufferRef) -> (f64, f64) {
    // SAFETY: two properties of type CFTimeInterval, which is a double.
    unsafe { (msg_send![commands, GPUStartTime], msg_send![commands, GPUEndTime]) }
}

/// Blocks until an event has reached `value`, for at most `milliseconds`. Returns false if the limit has passed.
pub(crate) fn wait_for_event(event: &SharedEventRef, value: u64, milliseconds: u64) -> bool {
    // SAFETY: the method (since macOS 12) takes two uint64_t, and returns a BOOL.
    let answer: BOOL = unsafe { msg_send![event, waitUntilSignaledValue: value timeoutMS: milliseconds] };
    answer == YES
}

/// Reads the first `count` timestamps of a counter sample buffer as 64-bit words; `None` if Metal returns fewer.
pub(crate) fn resolve(samples: &CounterSampleBufferRef, count: usize) -> Option<Vec<u64>> {
    pool(|| {
        let range = NSRange::new(0, count as u64);
        // SAFETY: the range lies within the buffer. The data, if there are any, are alive until the pool ends.
        let data: *mut Object = unsafe { msg_send![samples, resolveCounterRange: range] };
        if data.is_null() {
            return None;
        }
        // SAFETY: properties of an NSData.
        let (bytes, length): (*const c_void, u64) =
            unsafe { (msg_send![data, bytes], msg_send![data, length]) };
        if bytes.is_null() || length < 8 * count as u64 {
            return None;
        }
        // SAFETY: the data hold at least this many bytes. Words need not be aligned there.
        let words = (0..count).map(|word| unsafe { bytes.cast::<u64>().add(word).read_unaligned() });
        Some(words.collect())
    })
}

pub(crate) fn set_output(descriptor: &CaptureDescriptorRef, path: &Path) -> Result<(), String> {
    let text = path.to_str().and_then(|path| CString::new(path).ok());
    let text = text.ok_or_else(|| format!("expected a path in Unicode, found {}", path.display()))?;
    pool(|| {
        // SAFETY: the text ends with a zero, and is copied; classes of Foundation. The descriptor retains the URL.
        unsafe {
            let path: *mut Object = msg_send![class!(NSString), stringWithUTF8String: text.as_ptr()];
            let url: *mut Object = msg_send![class!(NSURL), fileURLWithPath: path];
            let () = msg_send![descriptor, setOutputURL: url];
        }
    });
    Ok(())
}

/// Makes a layer the content of a view. Call it only on the main thread.
///
/// # Safety
/// `view` must be a live NSView.
pub(crate) unsafe fn show_in_view(view: NonNull<c_void>, layer: &MetalLayerRef) {
    let view: *mut Object = view.as_ptr().cast();
    pool(|| {
        // SAFETY: the caller promises a view, which retains the layer. For a view without a window, the layer keeps its
        // scale of 1.
        unsafe {
            let window: *mut Object = msg_send![view, window];
            if !window.is_null() {
                let scale: f64 = msg_send![window, backingScaleFactor];
                layer.set_contents_scale(scale);
            }
            let () = msg_send![view, setLayer: layer];
            let () = msg_send![view, setWantsLayer: YES];
        }
    });
}

#[link(name = "CoreGraphics", kind = "framework")]
unsafe extern "C" {
    #[allow(non_upper_case_globals)]
    static kCGColorSpaceSRGB: *const c_void;
    fn CGColorSpaceCreateWithName(name: *const c_void) -> *mut c_void;
    fn CGColorSpaceRelease(space: *mut c_void);
}

/// Sets a layer's colour space to sRGB, because its pixels are display-encoded.
pub(crate) fn set_srgb(layer: &MetalLayerRef) {
    // SAFETY: the name is a constant of the framework; the layer retains the space that is created here and released.
    unsafe {
        let space = CGColorSpaceCreateWithName(kCGColorSpaceSRGB);
        let () = msg_send![layer, setColorspace: space];
        CGColorSpaceRelease(space);
    }
}

fn string(text: *mut Object) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: the string is alive until the caller's pool ends, and so are its bytes, which end with a zero.
    unsafe {
        let bytes: *const c_char = msg_send![text, UTF8String];
        if bytes.is_null() { String::new() } else { CStr::from_ptr(bytes).to_string_lossy().into_owned() }
    }
}
