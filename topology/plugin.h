#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/message_builder.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// Classes of components and groupings by name, as YAML names them. A component library fills it. It may also hold an
/// application: a function that adds components to the graph that YAML began (the paper's way: YAML declares what faces
/// the brokers, C++ puts the algorithm's graph together).
class ComponentRegistry {
 public:
  using Application = std::function<void(TopologyBuilder&, const Config&)>;

  template <typename T>
  void add_spout(const std::string& name) {
    spouts_[name] = [] { return std::make_unique<T>(); };
  }
  template <typename T>
  void add_bolt(const std::string& name) {
    bolts_[name] = [] { return make_bolt<T>(); };
  }
  /// Adds a bolt that needs more than its class, such as make_windowed_bolt<T>(options).
  void add_bolt(const std::string& name, BoltFactory factory) { bolts_[name] = std::move(factory); }
  /// Adds a Grouping, which YAML names as `grouping: custom, class: NAME`.
  template <typename T>
  void add_grouping(const std::string& name) {
    groupings_[name] = [] { return std::make_unique<T>(); };
  }
  /// Adds a MessageBuilder, which YAML names as `builder: NAME`.
  template <typename T>
  void add_builder(const std::string& name) {
    builders_[name] = [] { return std::make_unique<T>(); };
  }
  void set_application(Application application) { application_ = std::move(application); }

  /// \return nullptr if nothing of this kind is registered under the name.
  const SpoutFactory* spout(const std::string& name) const { return find(spouts_, name); }
  const BoltFactory* bolt(const std::string& name) const { return find(bolts_, name); }
  const GroupingFactory* grouping(const std::string& name) const { return find(groupings_, name); }
  const MessageBuilderFactory* builder(const std::string& name) const { return find(builders_, name); }
  const Application& application() const { return application_; }
  std::vector<std::string> spout_names() const { return names(spouts_); }
  std::vector<std::string> bolt_names() const { return names(bolts_); }
  std::vector<std::string> grouping_names() const { return names(groupings_); }
  std::vector<std::string> builder_names() const { return names(builders_); }

 private:
  template <typename Factory>
  static const Factory* find(const std::map<std::string, Factory>& factories, const std::string& name) {
    const auto found = factories.find(name);
    return found == factories.end() ? nullptr : &found->second;
  }
  template <typename Factory>
  static std::vector<std::string> names(const std::map<std::string, Factory>& factories) {
    std::vector<std::string> list;
    list.reserve(factories.size());
    for (const auto& [name, factory] : factories) list.push_back(name);
    return list;
  }
  std::map<std::string, SpoutFactory> spouts_;
  std::map<std::string, BoltFactory> bolts_;
  std::map<std::string, GroupingFactory> groupings_;
  std::map<std::string, MessageBuilderFactory> builders_;
  Application application_;
};

/// Raised with every change of the SDK after which component libraries must be compiled again.
#define IOTCLOUD_TOPOLOGY_SDK_VERSION 8
inline constexpr std::uint32_t sdk_version = IOTCLOUD_TOPOLOGY_SDK_VERSION;

/// This text, the version and a ';' stand in a library's bytes: what it was built with is known also when it cannot be
/// loaded.
#define IOTCLOUD_TOPOLOGY_SDK_MARK "iotcloud-plugin: topology-sdk="
#define IOTCLOUD_TOPOLOGY_STRINGIFY_(x) #x
#define IOTCLOUD_TOPOLOGY_STRINGIFY(x) IOTCLOUD_TOPOLOGY_STRINGIFY_(x)

#if defined(__GLIBCXX__) && _GLIBCXX_USE_CXX11_ABI
inline constexpr const char* cxx_abi = "itanium;libstdc++;cxx11=1";
#else
inline constexpr const char* cxx_abi = "another C++ library";
#endif

/// The description that a component library's one C function returns. The worker checks version, size and ABI before it
/// makes its first C++ call into the library.
struct LibraryDescriptor {
  std::uint32_t sdk_version;
  std::uint32_t size;
  const char* cxx_abi;
  void (*fill)(ComponentRegistry&);
};

inline constexpr const char* library_symbol = "iotcloud_topology_library";

}  // namespace iotcloud::topology

// A parameter's name cannot stand in parentheses: NOLINTBEGIN(bugprone-macro-parentheses)
/// Write it once in a component library, at file scope:
///   IOTCLOUD_TOPOLOGY_LIBRARY(registry) { registry.add_bolt<MyBolt>("my.Bolt"); }
#define IOTCLOUD_TOPOLOGY_LIBRARY(registry)                                                                          \
  static void iotcloud_fill_registry(iotcloud::topology::ComponentRegistry& registry);                               \
  extern "C" __attribute__((visibility("default"))) const iotcloud::topology::LibraryDescriptor*                     \
  iotcloud_topology_library() {                                                                                      \
    static const iotcloud::topology::LibraryDescriptor descriptor{                                                   \
        iotcloud::topology::sdk_version, sizeof(iotcloud::topology::LibraryDescriptor), iotcloud::topology::cxx_abi, \
        &iotcloud_fill_registry};                                                                                    \
    return &descriptor;                                                                                              \
  }                                                                                                                  \
  extern "C" __attribute__((visibility("default"), used)) const char iotcloud_topology_sdk_mark[] =                  \
      IOTCLOUD_TOPOLOGY_SDK_MARK IOTCLOUD_TOPOLOGY_STRINGIFY(IOTCLOUD_TOPOLOGY_SDK_VERSION) ";";                     \
  static void iotcloud_fill_registry(iotcloud::topology::ComponentRegistry& registry)
// NOLINTEND(bugprone-macro-parentheses)
