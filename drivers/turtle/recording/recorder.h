#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <string>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/recording/images.h>

/// What iotcloud-record does. Each call throws std::exception with a message for its user, ends early, with what there
/// is so far whole, on SIGINT and SIGTERM (which must be blocked in all threads), and tells `out` how far it is.
namespace iotcloud::drivers::turtle::recording {

struct RecordOptions {
  std::filesystem::path folder;
  PropertyMap properties;    ///< of the source, with `source`; the actuator is `none`
  std::uint64_t frames = 0;  ///< 0: as many as come
  double seconds = 0;        ///< 0: for ever
};
void record(const RecordOptions& options, std::ostream& out);

/// Checks a recording and plays it at its pace, or without a pause (`speed` 0).
struct PlayOptions {
  std::filesystem::path folder;
  double speed = 0;
};
void play(const PlayOptions& options, std::ostream& out);

struct ImportOptions {
  std::filesystem::path from, folder;
  Unit unit = Unit::mm;
  double rate = 30;  ///< frames a second
};
void import_images(const ImportOptions& options, std::ostream& out);

}  // namespace iotcloud::drivers::turtle::recording
