#include <iotcloud/bench/runtime/iotcloud_engine.h>
#include <iotcloud/bench/runtime/measure.h>

int main(int argc, char** argv) {
  return iotcloud::bench::measure("iotcloud", argc, argv, iotcloud::bench::make_iotcloud_engine);
}
