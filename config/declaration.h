#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// A driver plugin's declaration of itself, read from its bytes: the plugin is not loaded, and none of its code runs.
/// drivers/declaration.h is how a driver's author writes it.
namespace iotcloud::config {

/// A property that a driver declares.
struct DeclaredProperty {
  std::string name;
  std::string type = "text";  ///< "text", "number", "integer" or "flag"
  std::string unit;           ///< for people
  std::optional<double> min, max;
  std::optional<std::string> default_value;
  bool required = false;
  std::vector<std::string> choices;  ///< not empty: the values that it may have
  std::string text;                  ///< what it is, for people
  /// The values that it takes, in words: "a number from 0.1 to 1000".
  std::string values() const;
  friend bool operator==(const DeclaredProperty&, const DeclaredProperty&) = default;
};

/// All that a plugin declares.
struct DriverDeclaration {
  std::string driver;             ///< the driver's name; empty: the plugin says nothing of itself
  std::string version;            ///< the driver's own
  std::uint32_t sdk_version = 0;  ///< the SDK's version with which the plugin was built; 0: the plugin does not say
  std::string description;        ///< in a sentence or two
  /// nullopt: it declares none, and takes any.
  std::optional<std::vector<DeclaredProperty>> properties;
  friend bool operator==(const DriverDeclaration&, const DriverDeclaration&) = default;
};

/// Reads the declaration in the bytes of a plugin's file. Text that cannot be read counts as none: what a plugin says
/// is input.
DriverDeclaration declaration_in(std::string_view bytes);
/// The same of the JSON in a plugin's descriptor. \param json nullptr: it declares nothing
DriverDeclaration declaration_of(const char* json);
/// As JSON, which parse_declaration() reads.
std::string to_json(const DriverDeclaration& declaration);
/// Reads the JSON of to_json(); what cannot be read is left out.
DriverDeclaration parse_declaration(std::string_view json);

using Properties = std::map<std::string, std::string>;

/// A fault of one property of a deployment.
struct PropertyProblem {
  std::string property;
  std::string text;  ///< what is wrong, and what would be right; it begins with the value or the word "missing"
  friend bool operator==(const PropertyProblem&, const PropertyProblem&) = default;
};

/// Compares a deployment's properties with a declaration: unknown names, wrong types, values out of range, and required
/// ones that are missing. \return all that is wrong; empty: nothing, also when no property is declared
std::vector<PropertyProblem> problems_of(const Properties& properties, const DriverDeclaration& declaration);
/// All problems as one text; empty: there is none.
std::string text_of(const std::vector<PropertyProblem>& problems);
/// The properties, with the declared defaults of those that are not given.
Properties with_defaults(Properties properties, const DriverDeclaration& declaration);

/// In a property's value, this text stands for the number of the instance. The first instance has number 1.
inline constexpr std::string_view index_mark = "{index}";
/// The properties that have the mark, with an instance's number in its place.
Properties numbered(const Properties& properties, int index);

/// Whether the driver host takes the property for itself, so that no driver declares it.
bool is_host_property(const std::string& name);
/// The names of such properties, except those of channels.
const std::vector<std::string>& host_properties();

}  // namespace iotcloud::config
