#include <array>
#include <charconv>
#include <stdexcept>
#include <utility>

#include <dlfcn.h>
#include <libfreenect.h>
#include <sys/time.h>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/turtle/kinect/camera.h>

// libfreenect's replay (fakenect 0.5.3) lacks these functions; without them messages name no serial numbers.
extern "C" {
#pragma weak freenect_list_device_attributes
#pragma weak freenect_free_device_attributes
}

namespace iotcloud::drivers::turtle::kinect {

namespace {

constexpr int most_devices = 100;  // indexes have one or two digits, serial numbers more

/// What libfreenect logged last on this thread: its return values say only that something failed.
thread_local std::string last_words;

void take_log(freenect_context*, freenect_loglevel, const char* text) {
  last_words = text;
  while (!last_words.empty() && last_words.back() == '\n') last_words.pop_back();
}

std::string said() {
  return last_words.empty() ? std::string() : " (libfreenect: " + last_words + ")";
}

std::optional<int> as_index(const std::string& device) {
  int index = 0;
  const char* stop = device.data() + device.size();
  const auto [end, status] = std::from_chars(device.data(), stop, index);
  if (status != std::errc{} || end != stop || index < 0 || index >= most_devices) return std::nullopt;
  return index;
}

/// True if serial numbers can be listed, by the same library that serves the other calls: a replay that is loaded
/// before the real library has contexts of its own.
bool can_list() {
  if (!freenect_list_device_attributes || !freenect_free_device_attributes) return false;
  Dl_info list{}, init{};
  return dladdr(reinterpret_cast<void*>(&freenect_list_device_attributes), &list) != 0 &&
         dladdr(reinterpret_cast<void*>(&freenect_init), &init) != 0 && list.dli_fbase == init.dli_fbase;
}

std::string list_devices(freenect_context* context) {
  const int count = freenect_num_devices(context);
  if (count <= 0) return "there is no Kinect on this machine's USB (is its own power supply plugged in?)";
  std::string text = "there " + std::string(count == 1 ? "is 1 Kinect" : "are " + std::to_string(count) + " Kinects");
  freenect_device_attributes* first = nullptr;
  if (!can_list() || freenect_list_device_attributes(context, &first) < 0) return text;
  int index = 0;
  for (const auto* item = first; item; item = item->next, ++index) {
    text += (index == 0 ? ": " : ", ") + std::to_string(index) + " with serial number " +
            (item->camera_serial ? item->camera_serial : "unknown");
  }
  freenect_free_device_attributes(first);
  return text;
}

freenect_led_options led_option(const std::string& name) {
  constexpr std::array options{LED_OFF, LED_GREEN, LED_RED, LED_YELLOW, LED_BLINK_GREEN, LED_BLINK_RED_YELLOW};
  const auto& names = led_names();
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i] == name) return options[i];
  }
  throw std::invalid_argument("a Kinect has no light \"" + name + "\"");
}

}  // namespace

const std::vector<std::string>& led_names() {
  static const std::vector<std::string> names{"off", "green", "red", "yellow", "blink_green", "blink_red_yellow"};
  return names;
}

Camera::Camera(const CameraSettings& settings, std::uint16_t* buffer, OnDepth on_depth,
               const std::function<void(const std::string&)>& warn)
    : on_depth_(std::move(on_depth)) {
  try {
    open(settings);
    set_up_motor(settings, warn);
    start(buffer);
  } catch (...) {
    close();
    throw;
  }
}

Camera::~Camera() {
  close();
}

void Camera::open(const CameraSettings& settings) {
  last_words.clear();
  if (freenect_init(&context_, nullptr) < 0 || !context_) {
    context_ = nullptr;
    throw std::runtime_error("libfreenect cannot use this machine's USB" + said());
  }
  freenect_set_log_level(context_, FREENECT_LOG_ERROR);
  freenect_set_log_callback(context_, take_log);
  // Opens the motor only on request: libfreenect cannot open that of some models.
  const bool motor = settings.tilt || !settings.led.empty();
  freenect_select_subdevices(
      context_, static_cast<freenect_device_flags>(FREENECT_DEVICE_CAMERA | (motor ? FREENECT_DEVICE_MOTOR : 0)));
  const auto index = as_index(settings.device);
  const std::string wanted = index ? "number " + settings.device : "with serial number " + settings.device;
  if (freenect_num_devices(context_) <= index.value_or(0)) {
    throw std::runtime_error("no Kinect " + wanted + ": " + list_devices(context_));
  }
  const int status = index ? freenect_open_device(context_, &device_, *index)
                           : freenect_open_device_by_camera_serial(context_, &device_, settings.device.c_str());
  if (status < 0 || !device_) {
    device_ = nullptr;
    throw std::runtime_error("cannot open the Kinect " + wanted + said() + "; " + list_devices(context_) +
                             "; check that this user may open it and that no other program uses it");
  }
}

void Camera::set_up_motor(const CameraSettings& settings, const std::function<void(const std::string&)>& warn) {
  if (settings.tilt && freenect_set_tilt_degs(device_, *settings.tilt) < 0) {
    warn("the Kinect's tilt cannot be set" + said());
  }
  if (!settings.led.empty() && freenect_set_led(device_, led_option(settings.led)) < 0) {
    warn("the Kinect's light cannot be set" + said());
  }
}

void Camera::start(std::uint16_t* buffer) {
  freenect_set_user(device_, this);
  freenect_set_depth_callback(device_, &Camera::take_depth);
  const auto mode = freenect_find_depth_mode(FREENECT_RESOLUTION_MEDIUM, FREENECT_DEPTH_11BIT);
  if (static_cast<std::size_t>(mode.bytes) != depth::frame_pixels * sizeof(std::uint16_t) ||
      freenect_set_depth_mode(device_, mode) < 0 || freenect_set_depth_buffer(device_, buffer) < 0 ||
      freenect_start_depth(device_) < 0) {
    throw std::runtime_error("the Kinect does not start to send 11-bit depth" + said());
  }
}

void Camera::close() noexcept {
  if (device_) {
    freenect_stop_depth(device_);
    freenect_close_device(device_);
  }
  if (context_) freenect_shutdown(context_);
  device_ = nullptr;
  context_ = nullptr;
}

void Camera::take_depth(freenect_device* device, void*, std::uint32_t stamp) {
  auto* self = static_cast<Camera*>(freenect_get_user(device));
  freenect_set_depth_buffer(device, self->on_depth_(stamp));
}

bool Camera::poll(std::chrono::milliseconds limit) {
  timeval time{limit.count() / 1000, (limit.count() % 1000) * 1000};
  return freenect_process_events_timeout(context_, &time) >= 0;
}

}  // namespace iotcloud::drivers::turtle::kinect
