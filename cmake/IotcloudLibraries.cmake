# Every third-party library under one imported target, whatever way Debian lets us find it.
set(THREADS_PREFER_PTHREAD_FLAG ON)
find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(yaml-cpp REQUIRED)
find_package(rabbitmq-c REQUIRED)
find_package(Snappy REQUIRED)
find_package(spdlog REQUIRED)
find_package(fmt REQUIRED)
find_package(CLI11 REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(prometheus-cpp REQUIRED)
find_package(OpenSSL REQUIRED)
find_package(ZLIB REQUIRED)
find_package(PNG REQUIRED)
find_package(Boost 1.74 REQUIRED)
pkg_check_modules(libfreenect REQUIRED IMPORTED_TARGET libfreenect)
set(FAKENECT_DIR ${libfreenect_LIBDIR}/fakenect)  # its replay of recordings, which tests have in place of a device
pkg_check_modules(rdkafka REQUIRED IMPORTED_TARGET rdkafka)
pkg_check_modules(seccomp REQUIRED IMPORTED_TARGET libseccomp)
pkg_check_modules(systemd REQUIRED IMPORTED_TARGET libsystemd)
pkg_check_modules(libzip REQUIRED IMPORTED_TARGET libzip)
pkg_check_modules(thrift REQUIRED IMPORTED_TARGET thrift)
# Thrift reads a field's type from the bytes into an enum before it looks at it: with hostile bytes its headers and what
# it writes do what UBSan's check of enums forbids. GCC without -fstrict-enums gives that a meaning.
if(IOTCLOUD_SANITIZE MATCHES undefined)
  target_compile_options(PkgConfig::thrift INTERFACE -fno-sanitize=enum)
endif()
find_program(THRIFT_COMPILER thrift REQUIRED)

find_path(ZOOKEEPER_INCLUDE_DIR zookeeper/zookeeper.h REQUIRED)
find_library(ZOOKEEPER_LIBRARY zookeeper_mt REQUIRED)
add_library(zookeeper_mt INTERFACE IMPORTED)
target_include_directories(zookeeper_mt SYSTEM INTERFACE ${ZOOKEEPER_INCLUDE_DIR})
target_compile_definitions(zookeeper_mt INTERFACE THREADED)
target_link_libraries(zookeeper_mt INTERFACE ${ZOOKEEPER_LIBRARY} Threads::Threads)

# The protocol engine, by its file, because Debian ships it without the name that linkers look for.
find_path(QPID_PROTON_INCLUDE_DIR proton/connection_driver.h REQUIRED)
find_library(QPID_PROTON_CORE_LIBRARY libqpid-proton-core.so.10 REQUIRED)
set(QPID_PROTON_CORE -l:libqpid-proton-core.so.10)

# Optional: what needs a library that is not here is left out, and everything else is built. IOTCLOUD_NO_ROS and
# IOTCLOUD_NO_JNI say what is missing for whom, or nothing; tests that need it say so (MISSING, IotcloudTests.cmake).
find_path(ROCKSDB_INCLUDE_DIR rocksdb/db.h)
find_library(ROCKSDB_LIBRARY rocksdb)
find_path(HIREDIS_INCLUDE_DIR hiredis/hiredis.h)
find_library(HIREDIS_LIBRARY hiredis)
set(STORES_FOUND OFF)
if(ROCKSDB_INCLUDE_DIR AND ROCKSDB_LIBRARY AND HIREDIS_INCLUDE_DIR AND HIREDIS_LIBRARY)
  set(STORES_FOUND ON)
else()
  message(STATUS "Left out: topology/state (iotcloud::topology_state, bolts with state). It needs RocksDB and hiredis "
                 "(Debian: librocksdb-dev libhiredis-dev)")
endif()

pkg_check_modules(ros QUIET IMPORTED_TARGET roscpp geometry_msgs nav_msgs sensor_msgs)
set(IOTCLOUD_NO_ROS)
if(NOT ros_FOUND)
  string(CONCAT IOTCLOUD_NO_ROS "drivers/turtle/ros (turtle_ros.so, a TurtleBot on ROS) needs roscpp, geometry_msgs, nav_msgs "
                                "and sensor_msgs (Debian: libroscpp-dev libgeometry-msgs-dev libnav-msgs-dev libsensor-msgs-dev)")
  message(STATUS "Left out: ${IOTCLOUD_NO_ROS}")
endif()
find_package(JNI QUIET COMPONENTS JVM)
set(IOTCLOUD_NO_JNI)
if(NOT TARGET JNI::JNI)
  string(CONCAT IOTCLOUD_NO_JNI "libiotcloud_storm.so, with which Apache Storm runs components of C++, needs jni.h (Debian: "
                                "openjdk-17-jdk-headless)")
  message(STATUS "Left out: ${IOTCLOUD_NO_JNI}")
endif()
