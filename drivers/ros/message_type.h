#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json_fwd.hpp>

/// Types of ROS 1's messages, known at run time. Needs no ROS.
namespace iotcloud::drivers::ros {

/// A definition that is none, is hostile, or names a type that is not there. what() says where and why.
struct DefinitionError : std::runtime_error {
  using std::runtime_error::runtime_error;
};
/// Bytes that are no message of a type, or JSON that is none. what() says which field.
struct FormatError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A type of messages with all types that are in it. Immutable and thread safe.
///
/// JSON is that of rosbridge: a message is an object, `uint8[]` and `char[]` are texts in base64, `time` and `duration`
/// are {"secs": 1, "nsecs": 2}. A number that is none (NaN, infinity) is null.
class MessageType {
 public:
  /// \param name "geometry_msgs/Twist". \param text its definition and those of all types in it, as a publisher sends
  /// them: at most 1 MiB, 500 types, 10 000 fields and 32 types within each other. \throws DefinitionError
  static MessageType parse(const std::string& name, std::string_view text);
  /// Reads FOLDER/geometry_msgs/msg/Twist.msg, and the files of all types in it, each from the first folder that has
  /// it. \throws DefinitionError that names the folders
  static MessageType load(const std::string& name, const std::vector<std::string>& folders);

  const std::string& name() const { return name_; }
  /// MD5, in hexadecimal: two nodes understand each other if this is the same for both.
  std::string checksum() const;
  /// The text that parse() takes.
  std::string definition() const;

  /// \param most_bytes of the JSON. \throws FormatError when the bytes are no such message, or the JSON is longer
  std::string to_json(std::span<const std::byte> bytes, std::size_t most_bytes) const;
  /// Fields that the JSON lacks are 0 or empty. \throws FormatError for unknown fields and for values that do not fit,
  /// and when the message would be longer than `most_bytes`
  std::string from_json(std::string_view json, std::size_t most_bytes) const;

 private:
  static constexpr std::size_t deepest = 32;           ///< types within each other
  static constexpr int base64_in = 3, base64_out = 4;  ///< bytes, and the characters that they become
  enum class Basic {
    boolean,
    int8,
    uint8,
    int16,
    uint16,
    int32,
    uint32,
    int64,
    uint64,
    float32,
    float64,
    string,
    time,
    duration
  };
  enum class Array { none, any, fixed };
  struct Struct;
  struct Field {
    std::string type_text;  ///< as in the definition, with the package and the brackets
    std::string type;       ///< without the brackets
    std::string name;
    Array array = Array::none;
    std::uint32_t length = 0;       ///< of a fixed array
    Basic basic = Basic::uint8;     ///< unless it is a struct
    const Struct* inner = nullptr;  ///< owned by structs_
  };
  struct Struct {
    std::string name;
    std::string text;                    ///< its definition
    std::vector<std::string> constants;  ///< "int32 X=1", as they are hashed
    std::vector<Field> fields;
    bool connected = false;
  };
  class Reader;
  class Writer;

  static const Basic* basic_of(const std::string& type);
  static Struct read_struct(const std::string& name, const std::string& text);
  static Field read_field(const std::string& package, const std::string& type_text, const std::string& name);
  /// Connects the fields in `at` with their types. \throws DefinitionError
  void connect(Struct& at, std::size_t depth);
  void collect(const Struct& at, std::vector<const Struct*>& found) const;
  static std::string md5sum_of(const Struct& type);

  std::string name_;
  std::map<std::string, std::shared_ptr<Struct>> structs_;
};

}  // namespace iotcloud::drivers::ros
