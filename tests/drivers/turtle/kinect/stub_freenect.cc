#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <thread>

#include <libfreenect.h>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/tests/drivers/turtle/kinect/stub_freenect.h>

namespace stub = iotcloud::drivers::turtle::kinect::stub;
namespace depth = iotcloud::drivers::depth;

struct _freenect_context {
  freenect_log_cb log = nullptr;
  freenect_device* device = nullptr;
};
struct _freenect_device {
  freenect_context* context = nullptr;
  std::string serial;
  void* user = nullptr;
  freenect_depth_cb callback = nullptr;
  std::uint16_t* buffer = nullptr;
  bool started = false;
};

namespace {

std::mutex mutex;
std::condition_variable changed;
std::vector<stub::Kinect> usb;
stub::Seen state;
bool held = false;
bool sending = false;

const stub::Kinect* find(const std::string& serial) {
  const auto found = std::find_if(usb.begin(), usb.end(), [&](const auto& kinect) { return kinect.serial == serial; });
  return found == usb.end() ? nullptr : &*found;
}

int open(freenect_context* context, freenect_device** device, const stub::Kinect& kinect) {
  if (!kinect.opens) {
    if (context->log) context->log(context, FREENECT_LOG_ERROR, "Could not claim interface\n");
    return -1;
  }
  *device = context->device = new freenect_device{context, kinect.serial};
  ++state.devices;
  state.opened = kinect.serial;
  return 0;
}

}  // namespace

void stub::plug_in(std::vector<Kinect> kinects) {
  const std::lock_guard lock(mutex);
  usb = std::move(kinects);
}

void stub::hold(bool on) {
  std::unique_lock lock(mutex);
  held = on;
  changed.notify_all();
  changed.wait(lock, [] { return !held || !sending; });
}

stub::Seen stub::seen() {
  const std::lock_guard lock(mutex);
  return state;
}

void stub::reset() {
  const std::lock_guard lock(mutex);
  usb.clear();
  state = {};
  held = false;
}

extern "C" {

int freenect_init(freenect_context** context, freenect_usb_context*) {
  const std::lock_guard lock(mutex);
  *context = new freenect_context;
  ++state.contexts;
  return 0;
}
int freenect_shutdown(freenect_context* context) {
  const std::lock_guard lock(mutex);
  delete context;
  --state.contexts;
  return 0;
}
void freenect_set_log_level(freenect_context*, freenect_loglevel) {}
void freenect_set_log_callback(freenect_context* context, freenect_log_cb callback) {
  context->log = callback;
}
int freenect_num_devices(freenect_context*) {
  const std::lock_guard lock(mutex);
  return static_cast<int>(usb.size());
}
int freenect_list_device_attributes(freenect_context*, freenect_device_attributes** list) {
  const std::lock_guard lock(mutex);
  *list = nullptr;
  for (auto kinect = usb.rbegin(); kinect != usb.rend(); ++kinect) {
    auto* item = new freenect_device_attributes;
    item->next = *list;
    item->camera_serial = strdup(kinect->serial.c_str());
    *list = item;
  }
  return static_cast<int>(usb.size());
}
void freenect_free_device_attributes(freenect_device_attributes* list) {
  while (list) {
    auto* next = list->next;
    std::free(const_cast<char*>(list->camera_serial));
    delete list;
    list = next;
  }
}
void freenect_select_subdevices(freenect_context*, freenect_device_flags flags) {
  const std::lock_guard lock(mutex);
  state.motor_selected = (flags & FREENECT_DEVICE_MOTOR) != 0;
}
int freenect_open_device(freenect_context* context, freenect_device** device, int index) {
  const std::lock_guard lock(mutex);
  if (index < 0 || static_cast<std::size_t>(index) >= usb.size()) return -1;
  return open(context, device, usb[static_cast<std::size_t>(index)]);
}
int freenect_open_device_by_camera_serial(freenect_context* context, freenect_device** device, const char* serial) {
  const std::lock_guard lock(mutex);
  const auto* kinect = find(serial);
  return kinect ? open(context, device, *kinect) : -1;
}
int freenect_close_device(freenect_device* device) {
  const std::lock_guard lock(mutex);
  device->context->device = nullptr;
  delete device;
  --state.devices;
  return 0;
}
void freenect_set_user(freenect_device* device, void* user) {
  device->user = user;
}
void* freenect_get_user(freenect_device* device) {
  return device->user;
}
void freenect_set_depth_callback(freenect_device* device, freenect_depth_cb callback) {
  device->callback = callback;
}
int freenect_set_depth_buffer(freenect_device* device, void* buffer) {
  device->buffer = static_cast<std::uint16_t*>(buffer);
  return 0;
}
freenect_frame_mode freenect_find_depth_mode(freenect_resolution, freenect_depth_format format) {
  freenect_frame_mode mode{};
  mode.depth_format = format;
  mode.bytes = format == FREENECT_DEPTH_11BIT ? static_cast<std::int32_t>(depth::frame_pixels * 2) : 0;
  return mode;
}
int freenect_set_depth_mode(freenect_device*, freenect_frame_mode) {
  return 0;
}
int freenect_start_depth(freenect_device* device) {
  device->started = true;
  return 0;
}
int freenect_stop_depth(freenect_device* device) {
  device->started = false;
  return 0;
}
int freenect_set_tilt_degs(freenect_device* device, double angle) {
  const std::lock_guard lock(mutex);
  const auto* kinect = find(device->serial);
  if (!kinect || !kinect->has_motor) return -1;
  state.tilt = angle;
  return 0;
}
int freenect_set_led(freenect_device* device, freenect_led_options option) {
  const std::lock_guard lock(mutex);
  const auto* kinect = find(device->serial);
  if (!kinect || !kinect->has_motor) return -1;
  state.led = option;
  return 0;
}
int freenect_process_events_timeout(freenect_context* context, timeval*) {
  std::uint64_t number = 0;
  freenect_device* device = context->device;
  {
    std::unique_lock lock(mutex);
    const auto* kinect = find(device->serial);
    if (!kinect) return -1;
    if (held || !kinect->sends || !device->started) {
      changed.wait_for(lock, std::chrono::milliseconds(1));
      return 0;
    }
    number = ++state.frames;
    sending = true;
  }
  std::fill_n(device->buffer, depth::frame_pixels, static_cast<std::uint16_t>(number));
  device->callback(device, device->buffer, static_cast<std::uint32_t>(number * 120'000'000));
  const std::lock_guard lock(mutex);
  sending = false;
  changed.notify_all();
  return 0;
}

}  // extern "C"
