package iotcloud.storm;

import java.lang.invoke.MethodHandles;
import java.lang.invoke.VarHandle;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.util.AbstractList;
import java.util.RandomAccess;
import org.apache.storm.tuple.Tuple;

/**
 * The values of a tuple with a large payload, which stay in C++ (topology/storm/shim/parcel.h). A bolt of C++ in this worker
 * takes them there. For anybody who reads them here first (Storm, when it sends the tuple to another worker, or a component
 * in Java) the first look makes copies. Thread safe.
 */
final class Parcel extends AbstractList<Object> implements RandomAccess {
  private static final VarHandle ADDRESS;

  static {
    try {
      ADDRESS = MethodHandles.lookup().findVarHandle(Parcel.class, "address", long.class);
    } catch (ReflectiveOperationException error) {
      throw new ExceptionInInitializerError(error);
    }
  }

  private final int size;
  private volatile long address; // 0: somebody took it
  private volatile Object[] values; // null: none; without `whole` those that C++ told, at their places
  private boolean whole; // guarded by this

  /** `values`: those that C++ told, at their places; or null. */
  Parcel(long address, int size, Object[] values) {
    this.size = size;
    this.values = values;
    this.address = address;
  }

  /** Returns the parcel's address, which is the caller's now; 0: the values are copied already, or taken. */
  private long take() {
    return (long) ADDRESS.getAndSet(this, 0L);
  }

  /** Copies the values, unless that is done. */
  synchronized void open() {
    if (whole) {
      return;
    }
    long taken = take();
    if (taken == 0) {
      throw new IllegalStateException("a bolt of C++ has executed the tuple, and taken its values");
    }
    byte[][] parts = Native.unpack(taken);
    ByteBuffer bytes = ByteBuffer.wrap(parts[0]).order(ByteOrder.LITTLE_ENDIAN);
    ValueReader reader = new ValueReader(null);
    for (int i = 1; i < parts.length; i++) {
      reader.addArray(parts[i]);
    }
    Object[] copies = new Object[bytes.getInt()];
    for (int i = 0; i < copies.length; i++) {
      copies[i] = reader.value(bytes);
    }
    values = copies;
    whole = true;
  }

  @Override
  public Object get(int place) {
    Object[] now = values;
    if (now != null && now[place] != null) {
      return now[place];
    }
    open();
    return values[place];
  }

  @Override
  public int size() {
    return size;
  }

  @Override
  public boolean contains(Object sought) {
    if (sought instanceof Finder) {
      ((Finder) sought).found = this;
      return true;
    }
    return super.contains(sought);
  }

  /** Finds the parcels of a bolt's tuples: Storm gives each tuple's list in a wrapper, which passes a search on. */
  static final class Finder {
    private Parcel found;

    /** Takes the parcel that has the tuple's values; 0: they are here. */
    long take(Tuple tuple) {
      found = null;
      return tuple.getValues().contains(this) ? found.take() : 0;
    }
  }
}
