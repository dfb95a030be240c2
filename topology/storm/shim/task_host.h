#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/storm/shim/command_writer.h>
#include <iotcloud/topology/storm/shim/component_source.h>
#include <iotcloud/topology/storm/shim/task_description.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology::storm {

/// A component's object for one of Storm's tasks: what spouts and bolts have in common. Java makes one call at a time,
/// and applies the commands that it left, before the next one. A host lives until the process ends, because threads of
/// its component may call it.
class TaskHost {
 public:
  /// \param sink lives as long.
  TaskHost(const TaskDescription& task, Component component, std::span<std::byte> buffer, CommandSink& sink);
  virtual ~TaskHost() = default;
  TaskHost(const TaskHost&) = delete;
  TaskHost& operator=(const TaskHost&) = delete;

  /// Opens or prepares the component. \throws what it throws. \return as every call that may leave commands: their
  /// size in the buffer.
  std::size_t open();
  std::size_t close();

 protected:
  /// Calls the component itself. \throws what it throws
  virtual void open_component() = 0;
  virtual void close_component() = 0;

  /// Marks the calls that Java makes into this host, in whose course its component may emit.
  class OwnCall {
   public:
    explicit OwnCall(const TaskHost& host);
    ~OwnCall();
    OwnCall(const OwnCall&) = delete;
    OwnCall& operator=(const OwnCall&) = delete;
    static bool is_of(const TaskHost& host);

   private:
    const TaskHost* before_;
  };

  /// Runs user code. \return false when it threw: Java then gets the error.
  template <typename Call>
  bool guarded(std::string_view what, Call&& call) {
    try {
      call();
      return true;
    } catch (const std::exception& error) {
      write_error(what, error.what());
    } catch (...) {
      write_error(what, "something that is no std::exception");
    }
    return false;
  }

  /// A counter or histogram of this task among the process's metrics.
  config::Counter& counter(const std::string& name, const std::string& help) const;
  config::Histogram& histogram(const std::string& name, const std::string& help) const;
  /// The stream of that name, checked as our runtime checks it: the number of values, and the task of a direct stream.
  /// \throws std::invalid_argument when they do not fit.
  std::uint16_t checked_stream(std::string_view name, const Values& values, int task) const;
  /// Packs the values of a tuple that travels in a parcel. \param born_ns as add_birth()'s. \return null: it does not.
  ParcelPtr pack(std::uint16_t stream, Values& values, std::int64_t born_ns) const;
  /// Adds the birth to the values of a stream that has it. \param born_ns by the clock; 0: now
  void add_birth(std::uint16_t stream, Values& values, std::int64_t born_ns) const;
  /// The clock's time at which a tuple was born. \param wall_ms as its birth_field says
  std::int64_t birth_of(std::int64_t wall_ms) const;
  /// \throws std::logic_error unless a call of this host runs on this thread.
  void require_own_call() const;

  const config::Clock& clock_;
  const TaskDescription task_;
  const ComponentSpec spec_;
  EndpointProcess* const endpoints_;  ///< null: the component faces no broker
  TopologyContext context_;
  CommandWriter commands_;

 private:
  config::Labels labels() const;
  std::int64_t birth_ms(std::int64_t born_ns) const;
  void write_error(std::string_view what, std::string_view why);
};

}  // namespace iotcloud::topology::storm
