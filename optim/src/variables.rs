//! Variables: typed arrays of values, with each variable's role and its place in the linear system.

use std::any::{Any, TypeId};
use std::fmt;
use std::marker::PhantomData;

use crate::layout::VariableSlot;
use crate::manifold::{Manifold, Tangent};
use crate::schur::{Eliminate, LandmarkSpan, Schur};

/// Names a variable of type `T` within the problem that gave it out.
pub struct VariableId<T> {
    index: u32,
    kind: PhantomData<fn() -> T>,
}

impl<T> VariableId<T> {
    pub(crate) fn new(index: usize) -> Self {
        let index = u32::try_from(index).expect("fewer than 2^32 variables of a type");
        Self { index, kind: PhantomData }
    }

    /// Position among the variables of this type, in the order in which they were added.
    #[inline]
    #[must_use]
    pub fn index(self) -> usize {
        self.index as usize
    }
}

impl<T> Clone for VariableId<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for VariableId<T> {}
impl<T> PartialEq for VariableId<T> {
    fn eq(&self, other: &Self) -> bool {
        self.index == other.index
    }
}
impl<T> Eq for VariableId<T> {}
impl<T> PartialOrd for VariableId<T> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<T> Ord for VariableId<T> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.index.cmp(&other.index)
    }
}
impl<T> fmt::Debug for VariableId<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VariableId({})", self.index)
    }
}

/// Whether a variable stays in the reduced system or is eliminated from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Reduced,
    Landmark,
}

/// Which copy of the values: the accepted ones, or those of the step under trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    Current,
    Trial,
}

/// A variable of any type: which store, and where in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct VariableRef {
    pub store: u32,
    pub index: u32,
}

/// All variables of one type.
pub(crate) struct TypedStore<T> {
    values: Vec<T>,
    trial: Vec<T>,
    roles: Vec<Role>,
    fixed: Vec<bool>,
    slots: Vec<VariableSlot>,
}

/// What the solver does with variables without knowing their type.
pub(crate) trait Store: Any + Send + Sync {
    fn dim(&self) -> usize;
    fn len(&self) -> usize;
    fn role(&self, index: usize) -> Role;
    fn is_fixed(&self, index: usize) -> bool;
    fn set_slot(&mut self, index: usize, slot: VariableSlot);
    /// Copies the accepted values over those under trial.
    fn reset_trial(&mut self);
    /// Trial values: the accepted ones moved by the part of `step` that belongs to each free variable.
    fn retract(&mut self, step: &[f64]);
    /// Makes the trial values the accepted ones.
    fn accept(&mut self);
    /// See [`Schur::eliminate`]; here the landmarks' dimension is known to the compiler.
    fn eliminate(&self, schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>);
    /// See [`Schur::back_substitute`].
    fn back_substitute(&self, schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>);
    fn as_any(&self) -> &dyn Any;
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

impl<T: Manifold> Store for TypedStore<T> {
    fn dim(&self) -> usize {
        T::DIM
    }

    fn len(&self) -> usize {
        self.values.len()
    }

    fn role(&self, index: usize) -> Role {
        self.roles[index]
    }

    fn is_fixed(&self, index: usize) -> bool {
        self.fixed[index]
    }

    fn set_slot(&mut self, index: usize, slot: VariableSlot) {
        self.slots[index] = slot;
    }

    fn reset_trial(&mut self) {
        self.trial.clone_from(&self.values);
    }

    fn retract(&mut self, step: &[f64]) {
        for ((trial, value), slot) in self.trial.iter_mut().zip(&self.values).zip(&self.slots) {
            if !slot.is_fixed() {
                *trial = value.retract(&T::Tangent::from_slice(&step[slot.gradient as usize..]));
            }
        }
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.values, &mut self.trial);
    }

    fn eliminate(&self, schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>) {
        T::Tangent::eliminate(schur, landmarks);
    }

    fn back_substitute(&self, schur: &mut Schur<'_>, landmarks: LandmarkSpan<'_>) {
        T::Tangent::back_substitute(schur, landmarks);
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}

/// The variables of a problem, one store per type, in the order in which the types first appeared.
#[derive(Default)]
pub(crate) struct Stores {
    stores: Vec<Box<dyn Store>>,
    types: Vec<TypeId>,
}

impl Stores {
    pub(crate) fn add<T: Manifold>(&mut self, value: T, role: Role) -> VariableId<T> {
        let store = self.typed_or_new::<T>();
        let id = VariableId::new(store.values.len());
        store.trial.push(value.clone());
        store.values.push(value);
        store.roles.push(role);
        store.fixed.push(false);
        store.slots.push(VariableSlot::FIXED);
        id
    }

    pub(crate) fn get<T: Manifold>(&self, id: VariableId<T>) -> &T {
        &self.typed::<T>().values[id.index()]
    }

    pub(crate) fn set<T: Manifold>(&mut self, id: VariableId<T>, value: T) {
        self.typed_or_new::<T>().values[id.index()] = value;
    }

    pub(crate) fn is_fixed<T: Manifold>(&self, id: VariableId<T>) -> bool {
        self.typed::<T>().fixed[id.index()]
    }

    pub(crate) fn set_fixed<T: Manifold>(&mut self, id: VariableId<T>, fixed: bool) {
        self.typed_or_new::<T>().fixed[id.index()] = fixed;
    }

    pub(crate) fn variable_ref<T: Manifold>(&self, id: VariableId<T>) -> VariableRef {
        let store = self.position::<T>().unwrap_or_else(|| unknown_type::<T>());
        assert!(id.index() < self.stores[store].len(), "{id:?} is not a variable of this problem");
        VariableRef { store: store as u32, index: id.index }
    }

    pub(crate) fn values<T: Manifold>(&self, side: Side) -> &[T] {
        let store = self.typed::<T>();
        match side {
            Side::Current => &store.values,
            Side::Trial => &store.trial,
        }
    }

    pub(crate) fn slots<T: Manifold>(&self) -> &[VariableSlot] {
        &self.typed::<T>().slots
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &dyn Store> {
        self.stores.iter().map(|store| &**store)
    }

    pub(crate) fn iter_mut(&mut self) -> impl Iterator<Item = &mut Box<dyn Store>> {
        self.stores.iter_mut()
    }

    pub(crate) fn store(&self, index: usize) -> &dyn Store {
        &*self.stores[index]
    }

    fn position<T: Manifold>(&self) -> Option<usize> {
        self.types.iter().position(|&known| known == TypeId::of::<T>())
    }

    fn typed<T: Manifold>(&self) -> &TypedStore<T> {
        let store = self.position::<T>().unwrap_or_else(|| unknown_type::<T>());
        self.stores[store].as_any().downcast_ref().expect("the type id chose this store")
    }

    fn typed_or_new<T: Manifold>(&mut self) -> &mut TypedStore<T> {
        let store = self.position::<T>().unwrap_or_else(|| {
            self.types.push(TypeId::of::<T>());
            self.stores.push(Box::new(TypedStore::<T> {
                values: Vec::new(),
                trial: Vec::new(),
                roles: Vec::new(),
                fixed: Vec::new(),
                slots: Vec::new(),
            }));
            self.stores.len() - 1
        });
        self.stores[store].as_any_mut().downcast_mut().expect("the type id chose this store")
    }
}

fn unknown_type<T>() -> ! {
    panic!("no variable of type {} was added to this problem", std::any::type_name::<T>())
}
