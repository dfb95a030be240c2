#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/value_format.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology::storm {

/// Where a task's commands go: the Java object that applies them. All calls come from within a call that this object
/// made, on its thread.
class CommandSink {
 public:
  virtual ~CommandSink() = default;
  /// Applies the commands in the first `size` bytes of the buffer, which is free again afterwards.
  virtual void apply(std::size_t size) = 0;
  /// Replaces the buffer by one of `size` bytes or more. \pre it has no commands.
  virtual std::span<std::byte> grow(std::size_t size) = 0;
  /// Gives Java a copy of a value that the next command names.
  virtual void add_array(std::span<const std::byte> bytes) = 0;
  /// Wakes the executor of a spout's task. Any thread.
  virtual void wake() noexcept = 0;
};

/// Writes what a component wants of Storm, for Java to apply after the call, in order:
///
///   command = kind byte, then
///     1 emit     stream(2 bytes) task(4, -1: the groupings choose) count(4) slot(4)* values      by a bolt
///     2 ack, 3 fail, 4 reset the time-out of, 5 forget     slot(4)
///     6 error    count(4) byte*
///     7 emit     stream(2) task(4) tracked(1) message id(8) values                               by a spout
///     8 executes slot(4): what follows is of the execute() of this tuple, which Java did not call
///
/// A slot is the number under which Java keeps a tuple until it is acked, failed or forgotten; a stream is its number
/// in the task's description; values are as in value_format.h. A full buffer is applied before the call ends.
class CommandWriter {
 public:
  CommandWriter(std::span<std::byte> buffer, CommandSink& sink) : buffer_(buffer), sink_(sink) {}

  /// \param kept values that Java takes from its own tuples. \throws ValueFormatError for values that cannot be sent.
  void emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors, std::span<const Value> values,
            JavaValues kept = {});
  /// As emit(), by a spout. \param id nullptr: nobody tracks the tuple.
  void emit(std::uint16_t stream, int task, const std::uint64_t* id, std::span<const Value> values);
  /// The same, of values that stay in C++, whose parcel is Java's from now on. \param told as in task_description.h.
  /// \throws ValueFormatError, and leaves the parcel as it is.
  void emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors, ParcelPtr&& parcel,
            std::span<const std::size_t> told);
  void emit(std::uint16_t stream, int task, const std::uint64_t* id, ParcelPtr&& parcel,
            std::span<const std::size_t> told);
  void ack(std::uint32_t slot) { about(2, slot); }
  void fail(std::uint32_t slot) { about(3, slot); }
  void reset_timeout(std::uint32_t slot) { about(4, slot); }
  void forget(std::uint32_t slot) { about(5, slot); }
  void executes(std::uint32_t slot) { about(8, slot); }
  void error(std::string_view text);

  /// The bytes that were written and not applied yet; from now on the buffer is Java's until the next call.
  std::size_t take();

 private:
  void about(std::uint8_t kind, std::uint32_t slot);
  // Write what stands before the values, which have so many bytes, and arrays of so many. \return where these go
  std::byte* begin_emit(std::uint16_t stream, int task, std::span<const std::uint32_t> anchors, std::size_t values,
                        std::size_t arrays);
  std::byte* begin_emit(std::uint16_t stream, int task, const std::uint64_t* id, std::size_t values,
                        std::size_t arrays);
  /// Room for a command of `size` bytes, for which Java is given arrays of so many bytes.
  std::byte* room(std::size_t size, std::size_t arrays = 0);
  /// Writes the values, after Java was given its arrays.
  void write(std::span<const Value> values, std::byte* at);
  static void write(ParcelPtr&& parcel, std::span<const std::size_t> told, std::byte* at) noexcept;

  std::span<std::byte> buffer_;
  CommandSink& sink_;
  std::size_t used_ = 0;
  std::size_t arrays_ = 0;  ///< bytes of the arrays that Java was given for commands that it has not applied
  std::vector<std::optional<JavaValue>> elsewhere_;  ///< values of the command that is being written
};

}  // namespace iotcloud::topology::storm
