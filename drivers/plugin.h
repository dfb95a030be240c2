#pragma once

#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers {

/// Grows with every change that a plugin built before it cannot follow.
inline constexpr std::uint32_t sdk_version = 4;

/// Compiler, C++ library and its ABI: what C++ types at the border depend on.
#define IOTCLOUD_STRINGIFY_(x) #x
#define IOTCLOUD_STRINGIFY(x) IOTCLOUD_STRINGIFY_(x)
#if defined(__GLIBCXX__)
#define IOTCLOUD_CXX_ABI "itanium;libstdc++;cxx11=" IOTCLOUD_STRINGIFY(_GLIBCXX_USE_CXX11_ABI)
#else
#define IOTCLOUD_CXX_ABI "itanium;libc++"
#endif

/// A driver behind the plugin's border, as the host sees it: nothing throws. A non-empty `error` means that the call
/// failed and the instance with it.
class DriverShell {
 public:
  virtual ~DriverShell() = default;
  virtual std::vector<ChannelSpec> channels(const PropertyMap& properties, std::string& error) noexcept = 0;
  virtual void open(HostInterface& host, std::string& error) noexcept = 0;
  virtual void activate(std::string& error) noexcept = 0;
  virtual void deactivate(std::string& error) noexcept = 0;
  virtual void close(std::string& error) noexcept = 0;
  virtual void on_message(std::string_view channel, Message message, std::string& error) noexcept = 0;
  virtual void on_writable(std::string_view channel, std::string& error) noexcept = 0;
};

/// The one C symbol of a driver plugin returns this. The first three members never move, so that a host can refuse any
/// plugin with a message that names both sides before it makes a C++ call.
struct Descriptor {
  std::uint32_t sdk_version;
  std::uint32_t size;  ///< sizeof(Descriptor) where the plugin was built
  const char* cxx_abi;
  const char* name;  ///< the driver's name ("turtle")
  const char* version;
  bool own_thread;           ///< each instance needs an event thread of its own (it blocks or computes long)
  DriverShell* (*create)();  ///< nullptr on failure
  void (*destroy)(DriverShell*);
};

inline constexpr const char* descriptor_symbol = "iotcloud_driver_descriptor";

namespace detail {

/// Puts a user's driver behind the border.
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
  std::unique_ptr<DriverContext> context_;  ///< outlives driver_: declared first
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

/// A descriptor for a driver class, also without a shared library (in-process use, tests).
template <typename UserDriver>
Descriptor describe(const char* name, const char* version, bool own_thread = false) {
  return Descriptor{sdk_version,
                    sizeof(Descriptor),
                    IOTCLOUD_CXX_ABI,
                    name,
                    version,
                    own_thread,
                    &detail::create<UserDriver>,
                    [](DriverShell* shell) { delete shell; }};
}

}  // namespace iotcloud::drivers

/// Once in a plugin, at file scope: IOTCLOUD_DRIVER(TurtleDriver, "turtle", "1.0", true)
/// Arguments as for iotcloud::drivers::describe.
#define IOTCLOUD_DRIVER(UserDriver, ...)                                                 \
  extern "C" __attribute__((visibility("default"))) const iotcloud::drivers::Descriptor* \
  iotcloud_driver_descriptor() {                                                         \
    static const auto descriptor = iotcloud::drivers::describe<UserDriver>(__VA_ARGS__); \
    return &descriptor;                                                                  \
  }

/// Stands in a plugin's bytes, where a gateway finds it without loading the plugin.
#define IOTCLOUD_DRIVER_ISOLATION_MARK "iotcloud-plugin: isolation=instance"

/// Once beside IOTCLOUD_DRIVER, in a plugin of which a process can hold one instance only (roscpp knows one node): each
/// instance gets a host of its own, unless its property `isolation` says something else.
#define IOTCLOUD_DRIVER_ISOLATED                                                                        \
  extern "C" __attribute__((visibility("default"), used)) const char iotcloud_driver_isolation_mark[] = \
      IOTCLOUD_DRIVER_ISOLATION_MARK;
