#pragma once

#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/declaration.h>
#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

/// Raised with every change of the SDK after which plugins must be compiled again.
#define IOTCLOUD_DRIVER_SDK_VERSION 7
inline constexpr std::uint32_t sdk_version = IOTCLOUD_DRIVER_SDK_VERSION;

/// Compiler, C++ library and ABI: a host loads a plugin only if both agree on the layout of C++ types.
#define IOTCLOUD_STRINGIFY_(x) #x
#define IOTCLOUD_STRINGIFY(x) IOTCLOUD_STRINGIFY_(x)
#if defined(__GLIBCXX__)
#define IOTCLOUD_CXX_ABI "itanium;libstdc++;cxx11=" IOTCLOUD_STRINGIFY(_GLIBCXX_USE_CXX11_ABI)
#else
#define IOTCLOUD_CXX_ABI "itanium;libc++"
#endif

/// A driver as the host calls it, across the plugin's border. No call throws; a non-empty `error` means that the call
/// failed, and the instance with it.
class DriverShell {
 public:
  virtual ~DriverShell() = default;
  // Each calls the method of Driver that has its name.
  virtual std::vector<ChannelSpec> channels(const PropertyMap& properties, std::string& error) noexcept = 0;
  virtual void open(HostInterface& host, std::string& error) noexcept = 0;
  virtual void activate(std::string& error) noexcept = 0;
  virtual void deactivate(std::string& error) noexcept = 0;
  virtual void close(std::string& error) noexcept = 0;
  virtual void on_message(std::string_view channel, Message message, std::string& error) noexcept = 0;
  virtual void on_writable(std::string_view channel, std::string& error) noexcept = 0;
  virtual void on_stored(std::string_view channel, std::uint64_t count, std::string& error) noexcept = 0;
};

/// The description that the plugin's one C symbol returns. The first three members never move: a host checks them
/// before its first C++ call, and refuses a plugin that does not fit with a message that names both sides.
struct Descriptor {
  std::uint32_t sdk_version;
  std::uint32_t size;  ///< the plugin's sizeof(Descriptor)
  const char* cxx_abi;
  const char* name;  ///< the driver's name ("turtle")
  const char* version;
  bool own_thread;           ///< each instance needs an event thread of its own because it blocks or computes for long
  DriverShell* (*create)();  ///< nullptr on failure
  void (*destroy)(DriverShell*);
  const char* declaration;  ///< JSON of properties and description, see declaration.h; nullptr: nothing is declared
};

/// This text, the version and a ';' stand in a plugin's bytes: what it was built with is known also when it cannot be
/// loaded.
#define IOTCLOUD_DRIVER_SDK_MARK "iotcloud-plugin: driver-sdk="

inline constexpr const char* descriptor_symbol = "iotcloud_driver_descriptor";

namespace detail {

/// Catches what a user's driver throws, so that no exception crosses the plugin's border.
template <typename UserDriver>
class Shell final : public DriverShell {
 public:
  std::vector<ChannelSpec> channels(const PropertyMap& properties, std::string& error) noexcept override {
    std::vector<ChannelSpec> specs;
    run(error, [&] { specs = driver_.channels(properties); });
    return specs;
  }
  void open(HostInterface& host, std::string& error) noexcept override {
    run(error, [&] {
      context_ = std::make_unique<DriverContext>(host);
      driver_.open(*context_);
    });
  }
  void activate(std::string& error) noexcept override {
    run(error, [&] { driver_.activate(); });
  }
  void deactivate(std::string& error) noexcept override {
    run(error, [&] { driver_.deactivate(); });
  }
  void close(std::string& error) noexcept override {
    run(error, [&] { driver_.close(); });
  }
  void on_message(std::string_view channel, Message message, std::string& error) noexcept override {
    run(error, [&] { driver_.on_message(channel, std::move(message)); });
  }
  void on_writable(std::string_view channel, std::string& error) noexcept override {
    run(error, [&] { driver_.on_writable(channel); });
  }
  void on_stored(std::string_view channel, std::uint64_t count, std::string& error) noexcept override {
    run(error, [&] { driver_.on_stored(channel, count); });
  }

 private:
  template <typename Call>
  static void run(std::string& error, Call&& call) noexcept {
    try {
      call();
    } catch (const std::exception& e) {
      error = e.what();
    } catch (...) {
      error = "an exception that is not a std::exception";
    }
  }
  std::unique_ptr<DriverContext> context_;  ///< declared before driver_, so that it outlives it
  UserDriver driver_;
};

template <typename UserDriver>
DriverShell* create() {
  try {
    return new Shell<UserDriver>;
  } catch (...) {
    return nullptr;
  }
}

}  // namespace detail

/// The descriptor of a driver class. Needs no shared library, so in-process use and tests call it too.
template <typename UserDriver>
Descriptor describe(const char* name, const char* version, bool own_thread = false) {
  return Descriptor{sdk_version,
                    sizeof(Descriptor),
                    IOTCLOUD_CXX_ABI,
                    name,
                    version,
                    own_thread,
                    &detail::create<UserDriver>,
                    [](DriverShell* shell) { delete shell; },
                    detail::declaration_of<UserDriver>()};
}

}  // namespace iotcloud::drivers

/// Exports the driver's descriptor. Write it once in a plugin, at file scope: IOTCLOUD_DRIVER(TurtleDriver, "turtle",
/// "1.0", true). The arguments are those of iotcloud::drivers::describe.
#define IOTCLOUD_DRIVER(UserDriver, ...)                                                          \
  extern "C" __attribute__((visibility("default"))) const iotcloud::drivers::Descriptor*          \
  iotcloud_driver_descriptor() {                                                                  \
    static const auto descriptor = iotcloud::drivers::describe<UserDriver>(__VA_ARGS__);          \
    return &descriptor;                                                                           \
  }                                                                                               \
  extern "C" __attribute__((visibility("default"), used)) const char iotcloud_driver_sdk_mark[] = \
      IOTCLOUD_DRIVER_SDK_MARK IOTCLOUD_STRINGIFY(IOTCLOUD_DRIVER_SDK_VERSION) ";";               \
  extern "C" __attribute__((visibility("default"), used)) const auto iotcloud_driver_card =       \
      iotcloud::drivers::detail::card_with_mark(__VA_ARGS__);

/// This text stands in a plugin's bytes, so that a gateway finds it without loading the plugin.
#define IOTCLOUD_DRIVER_ISOLATION_MARK "iotcloud-plugin: isolation=instance"

/// Write it once beside IOTCLOUD_DRIVER, in a plugin of which a process can hold one instance only (roscpp knows one
/// node): each instance then gets a host of its own, unless its property `isolation` says something else.
#define IOTCLOUD_DRIVER_ISOLATED                                                                        \
  extern "C" __attribute__((visibility("default"), used)) const char iotcloud_driver_isolation_mark[] = \
      IOTCLOUD_DRIVER_ISOLATION_MARK;
